//! The printed markers: AprilTags of the family tag36h11 (Olson 2011; Wang and Olson 2016), and what a picture shows of them.
//!
//! Three libraries were compared. `kornia-apriltag` is pure Rust, a port of the reference detector, and is kept: chosen.
//! `apriltag` binds the reference C library and so needs a C compiler and CMake on every machine. `aprilgrid` finds the saddle
//! points of calibration boards, whose markers touch at black corner squares; a marker that stands alone has none. The library only
//! finds and names markers here, its corners good to half a pixel: edges are measured in [`super::edges`].

use super::camera::{Lens, Side};
use super::edges::Grey;
use super::{CoarseError, MarkerId, Place};
use kornia_apriltag::family::{TagFamily, TagFamilyKind};
use kornia_apriltag::{AprilTagDecoder, DecodeTagsConfig};
use kornia_image::{Image, ImageSize};
use nalgebra::Vector2;
use std::sync::OnceLock;

/// Squares along a marker's side, the white margin of one square on each side included.
pub const CELLS: usize = 10;
/// Squares along the black border's outer edge, whose length is the marker's size.
pub const BORDER_CELLS: usize = 8;

/// A marker's squares, row by row from the top left of the upright marker, margin included; true is white.
pub type Cells = [[bool; CELLS]; CELLS];

fn family() -> Option<&'static TagFamily> {
    static FAMILY: OnceLock<Option<TagFamily>> = OnceLock::new();
    FAMILY.get_or_init(|| TagFamily::tag36_h11().ok()).as_ref()
}

/// How a marker looks, upright as in the official images; `None` above the family's last id, 586.
pub fn cells(id: MarkerId) -> Option<Cells> {
    let family = family()?;
    let code = family.code_data.get(usize::from(id.0))?;
    let mut cells = [[false; CELLS]; CELLS];
    for (row, line) in cells.iter_mut().enumerate() {
        for (column, white) in line.iter_mut().enumerate() {
            *white = [row, column].iter().any(|&k| k == 0 || k == CELLS - 1);
        }
    }
    for (bit, (x, y)) in family.bit_x.iter().zip(&family.bit_y).enumerate() {
        let white = code >> (family.nbits - 1 - bit) & 1 == 1;
        cells[*y as usize + 1][*x as usize + 1] = white;
    }
    Some(cells)
}

/// A marker found in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Which.
    pub id: MarkerId,
    /// The black border's outer corners, px: of the upright marker the top left, top right, bottom right and bottom left one.
    pub corners: [Vector2<f64>; 4],
    /// Squares read wrongly, of 36.
    pub wrong: u8,
}

/// The black border's outer corners in the marker's frame, in the order of [`Found::corners`], for a marker of this size.
pub fn outline(size_mm: f64) -> [Vector2<f64>; 4] {
    let h = size_mm / 2.0;
    [Vector2::new(-h, -h), Vector2::new(h, -h), Vector2::new(h, h), Vector2::new(-h, h)]
}

/// Finds the markers of a picture, in the order of their ids.
///
/// # Errors
/// [`CoarseError::Detector`] when the library refuses the picture.
pub fn find(picture: &Grey) -> Result<Vec<Found>, CoarseError> {
    // Binarising at the middle keeps margins of dark pictures, at a third those of blurred ones; together they miss least.
    find_with(picture, &[(0.5, 1), (0.33, 1), (0.5, 2)])
}

/// As [`find`], with these ways of binarising: the share between black and white, and by how much to shrink the picture.
fn find_with(picture: &Grey, ways: &[(f32, usize)]) -> Result<Vec<Found>, CoarseError> {
    let refused = |e: &dyn std::fmt::Display| CoarseError::Detector(e.to_string());
    let size = ImageSize { width: picture.width, height: picture.height };
    let mut found: Vec<Found> = Vec::new();
    for &(split, downscale) in ways {
        let mut config = DecodeTagsConfig::new(vec![TagFamilyKind::Tag36H11]).map_err(|e| refused(&e))?;
        (config.threshold_split, config.downscale_factor) = (split, downscale);
        let mut decoder = AprilTagDecoder::new(config, size).map_err(|e| refused(&e))?;
        let pixels = picture.values.iter().map(|v| v.round().clamp(0.0, 255.0) as u8).collect();
        let image = Image::<u8, 1>::new(size, pixels).map_err(|e| refused(&e))?;
        for tag in decoder.decode(&image).map_err(|e| refused(&e))? {
            // The library counts from a pixel's corner.
            let at = |x: f32, y: f32| {
                let p = tag.quad.homography_project(x, y);
                Vector2::new(f64::from(p.x) - 0.5, f64::from(p.y) - 0.5)
            };
            let corners = [at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)];
            let new = Found { id: MarkerId(tag.id), corners, wrong: tag.hamming };
            let same = |old: &Found| old.id == new.id && (old.centre() - new.centre()).norm() < old.span() / 2.0;
            if new.span() > 12.0 && !found.iter().any(same) {
                found.push(new);
            }
        }
    }
    found.sort_by_key(|f| f.id);
    Ok(found)
}

impl Found {
    /// The mean of the corners, px.
    pub fn centre(&self) -> Vector2<f64> {
        self.corners.iter().sum::<Vector2<f64>>() / 4.0
    }

    /// The longer diagonal, px.
    pub fn span(&self) -> f64 {
        (self.corners[0] - self.corners[2]).norm().max((self.corners[1] - self.corners[3]).norm())
    }

    /// The corners' directions through a lens.
    pub fn directions(&self, lens: &Lens) -> [Vector2<f64>; 4] {
        self.corners.map(|c| lens.direction(c))
    }
}

/// Refuses a picture in which only the mirror image of a marker can be read, and that without fault, as clutter hardly ever does.
///
/// # Errors
/// [`CoarseError::Mirrored`], naming the ids.
pub fn refuse_mirrored(picture: &Grey, found: &[Found], place: Place, side: Side) -> Result<(), CoarseError> {
    let mut mirrored = picture.clone();
    for row in mirrored.values.chunks_mut(picture.width) {
        row.reverse();
    }
    let last = picture.width as f64 - 1.0;
    let real = |f: &Found| {
        let c = f.centre();
        found.iter().any(|g| (g.centre() - Vector2::new(last - c.x, c.y)).norm() < g.span() / 2.0)
    };
    let ids: Vec<MarkerId> =
        find_with(&mirrored, &[(0.5, 1)])?.iter().filter(|f| f.wrong == 0 && !real(f)).map(|f| f.id).collect();
    if ids.is_empty() { Ok(()) } else { Err(CoarseError::Mirrored { place, side, ids }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Marker 0 as the family's authors publish it (AprilRobotics/apriltag-imgs, tag36_11_00000), without the margin.
    #[test]
    fn marker_0_is_the_official_one_upright() {
        let rows = cells(MarkerId(0)).unwrap()[1..9]
            .iter()
            .map(|row| row[1..9].iter().map(|w| if *w { '#' } else { '.' }).collect::<String>())
            .collect::<Vec<_>>();
        assert_eq!(rows[0], "........");
        assert_eq!(rows[7], "........");
        assert_eq!(
            rows[1..7],
            [".##.#.#.", "..###.#.", "..##....", ".#.#....", "..#.##..", "....#..."].map(String::from)
        );
    }

    #[test]
    fn the_family_ends_at_586() {
        assert!(cells(MarkerId(586)).is_some() && cells(MarkerId(587)).is_none());
    }
}
