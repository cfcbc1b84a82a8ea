//! Whether a picture can be focused at all: a blank one has nothing to be sharp, a saturated one hides where it is.

use super::simd::{self, Pixel, Plane};
use super::with_plane;
use crate::picture::View;
use parfocal_protocol::autofocus::FrameFault;

/// Share of saturated pixels from which on a picture is refused: highlights and dust stay below, a lamp set too
/// bright does not.
pub const SATURATED_SHARE: f64 = 0.25;

/// What a picture's grey values allow.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Quality {
    /// Smallest grey value.
    pub low: u16,
    /// Largest grey value.
    pub high: u16,
    /// Share of pixels, 0 to 1, at the top of the camera's scale.
    pub saturated: f64,
}

impl Quality {
    /// Looks at a picture.
    ///
    /// The top of a 16-bit scale is not known: cameras of 10, 12 and 14 bits deliver their values in its lower or in its
    /// upper bits. So a largest value that is the top of one of these scales counts as saturated.
    pub fn of(view: View<'_>) -> Self {
        with_plane!(view, |plane| inspect(&plane))
    }

    /// Why focusing on it makes no sense, if so: [`FrameFault::Saturated`] from [`SATURATED_SHARE`] on,
    /// [`FrameFault::Blank`] when the grey values span one step at most.
    pub fn fault(&self) -> Option<FrameFault> {
        if self.saturated >= SATURATED_SHARE {
            Some(FrameFault::Saturated)
        } else if self.high - self.low <= 1 {
            Some(FrameFault::Blank)
        } else {
            None
        }
    }
}

/// Largest values of 10, 12, 14 and 16 bits, in the lower and in the upper bits of 16.
const TOPS: [u32; 7] = [0x3ff, 0xfff, 0x3fff, 0xffff, 0xffc0, 0xfff0, 0xfffc];

/// Whether a picture's largest value is the top of its camera's scale.
pub(super) fn is_top<P: Pixel>(high: u32) -> bool {
    if P::LEVELS == 256 { high == 255 } else { TOPS.contains(&high) }
}

fn inspect<P: Pixel>(plane: &Plane<'_, P>) -> Quality {
    let (low, high) = simd::extremes(plane);
    let at_top = |row: &[P]| row.iter().filter(|&&p| Into::<u32>::into(p) == high).count();
    let saturated = if is_top::<P>(high) { plane.rows().map(at_top).sum() } else { 0 };
    let grey = |value: u32| u16::try_from(value).unwrap_or(u16::MAX);
    Quality { low: grey(low), high: grey(high), saturated: saturated as f64 / plane.area() as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Picture;

    fn fault16(data: Vec<u16>) -> Option<FrameFault> {
        Quality::of(Picture::grey16(data.len(), 1, data).unwrap().view()).fault()
    }

    #[test]
    fn blank_and_saturated_pictures_are_told_from_good_ones() {
        assert_eq!(fault16(vec![700; 9]), Some(FrameFault::Blank));
        assert_eq!(fault16(vec![0, 1, 0, 1]), Some(FrameFault::Blank));
        assert_eq!(fault16(vec![0, 2, 0, 1]), None);
        for top in TOPS {
            let top = top as u16;
            assert_eq!(fault16(vec![top; 4]), Some(FrameFault::Saturated), "white is too bright, not blank");
            assert_eq!(fault16(vec![5, top, 9, 7]), Some(FrameFault::Saturated));
            assert_eq!(fault16(vec![5, top, 9, 7, 8]), None);
        }
        let grey8 = Picture::grey8(2, 2, vec![255, 255, 3, 4]).unwrap();
        assert_eq!(Quality::of(grey8.view()), Quality { low: 3, high: 255, saturated: 0.5 });
        assert_eq!(Quality::of(grey8.view()).fault(), Some(FrameFault::Saturated));
    }
}
