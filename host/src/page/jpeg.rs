//! A frame as the page shows it: grey values stretched to 8 bits, then JPEG.

use crate::frames::camera::Frame;
use crate::picture::{Data, Picture};
use image::codecs::jpeg::JpegEncoder;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, PoisonError};

/// Which grey values are shown black and white.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Levels {
    /// The darkest and the brightest half per cent of the frame.
    #[default]
    Auto,
    /// The whole scale of its type.
    Full,
    /// These grey values.
    Fixed {
        /// Shown black.
        low: u16,
        /// Shown white.
        high: u16,
    },
}

/// A frame ready to be sent.
#[derive(Clone, Debug)]
pub struct Encoded {
    /// Number of the frame in the feed.
    pub number: u64,
    /// The JPEG file.
    pub jpeg: Arc<[u8]>,
    /// The grey values shown black and white.
    pub shown: (u16, u16),
}

/// JPEG's quality, of 100: edges of a tip stay sharp.
const QUALITY: u8 = 85;
/// Pixels looked at to find the levels: every so many.
const EVERY: usize = 7;

/// Encodes one frame at a time and keeps what it encoded last, for several browsers that look at the same.
#[derive(Debug, Default)]
pub struct Encoder {
    last: Mutex<Option<(Levels, Encoded)>>,
}

impl Encoder {
    /// The frame as JPEG.
    pub fn encode(&self, number: u64, frame: &Frame, levels: Levels) -> Encoded {
        // One at a time: an encoder never takes more than one processor from a scan.
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((shown, encoded)) = &*last
            && *shown == levels
            && encoded.number == number
        {
            return encoded.clone();
        }
        let picture = &frame.picture;
        let shown = range(picture, levels);
        let grey = stretched(picture, shown);
        let mut bytes = Vec::with_capacity(grey.len() / 4);
        // Writing to memory fails only for pictures wider than JPEG can be: the page then shows nothing.
        let _ = JpegEncoder::new_with_quality(&mut bytes, QUALITY).encode(
            &grey,
            picture.width as u32,
            picture.height as u32,
            image::ExtendedColorType::L8,
        );
        let encoded = Encoded { number, jpeg: bytes.into(), shown };
        *last = Some((levels, encoded.clone()));
        encoded
    }
}

/// The grey values to be shown black and white; the second is above the first.
fn range(picture: &Picture, levels: Levels) -> (u16, u16) {
    let full = match picture.data {
        Data::Grey8(_) => 255,
        Data::Grey16(_) => u16::MAX,
    };
    let (low, high) = match levels {
        Levels::Full => (0, full),
        Levels::Fixed { low, high } => (low, high),
        Levels::Auto => {
            let mut sample: Vec<u16> = match &picture.data {
                Data::Grey8(data) => data.iter().step_by(EVERY).map(|v| u16::from(*v)).collect(),
                Data::Grey16(data) => data.iter().step_by(EVERY).copied().collect(),
            };
            let (last, part) = (sample.len() - 1, sample.len() / 200);
            let low = *sample.select_nth_unstable(part).1;
            let high = *sample.select_nth_unstable(last - part).1;
            // Noise alone is not blown up to black and white.
            let least = if full == 255 { 12 } else { 1200 };
            let spare = u16::saturating_sub(least, high - low) / 2;
            (low.saturating_sub(spare), high.saturating_add(spare))
        }
    };
    (low.min(full - 1), high.clamp(low.min(full - 1) + 1, full))
}

fn stretched(picture: &Picture, (low, high): (u16, u16)) -> Vec<u8> {
    let scale = 255.0 / f32::from(high - low);
    let grey = |v: u16| (f32::from(v.saturating_sub(low)) * scale + 0.5) as u8;
    match &picture.data {
        Data::Grey8(data) => {
            let table: Vec<u8> = (0..=255).map(grey).collect();
            data.iter().map(|v| table[usize::from(*v)]).collect()
        }
        Data::Grey16(data) => data.iter().map(|v| grey(*v)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use parfocal_protocol::units::HostTime;

    #[test]
    fn a_frame_is_stretched_to_black_and_white() {
        let picture = Picture::grey16(100, 10, (0..1000).map(|v| 20_000 + 10 * v).collect()).unwrap();
        let (low, high) = range(&picture, Levels::Auto);
        assert!((20_000..20_200).contains(&low) && (29_800..30_000).contains(&high), "{low} {high}");
        let grey = stretched(&picture, (low, high));
        assert_eq!((grey[0], grey[999]), (0, 255));
        assert_eq!(range(&picture, Levels::Fixed { low: 9, high: 3 }), (9, 10));
        assert_eq!(range(&picture, Levels::Fixed { low: u16::MAX, high: 0 }), (u16::MAX - 1, u16::MAX));
        let flat = Picture::grey8(3, 3, vec![200; 9]).unwrap();
        assert_eq!(range(&flat, Levels::Auto), (194, 206));
    }

    #[test]
    fn what_is_encoded_is_a_jpeg_of_the_same_picture() {
        let data = (0..64 * 48).map(|i| ((i % 64) * 4) as u8).collect();
        let picture = Picture::grey8(64, 48, data).unwrap();
        let frame = Frame { picture, number: 0, exposure: None, arrival: HostTime(0) };
        let encoded = Encoder::default().encode(7, &frame, Levels::Full);
        let back = image::load_from_memory(&encoded.jpeg).unwrap().to_luma8();
        assert_eq!(back.dimensions(), (64, 48));
        let worst = back.enumerate_pixels().map(|(x, _, p)| (i32::from(p.0[0]) - 4 * x as i32).abs()).max();
        assert!(worst < Some(12), "{worst:?}");
    }
}
