//! Calibration of the stereo camera itself, from pairs of pictures of a printed board.
//!
//! The board is a grid of markers. Each marker's corners are taken from its fitted edges; lenses, the cameras' relative pose and the
//! board's pose in every pair are then adjusted to them at once (Zhang 2000; Triggs et al. 2000). A second pass measures the edges again
//! with the lenses of the first, so that straight edges bent by the lens are no error.

mod adjust;
mod corners;
mod start;

use super::camera::{Lens, Side, StereoCamera};
use super::edges::Grey;
use super::register::Pair;
use super::{CoarseError, MarkerId, Place};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A printed grid of markers, numbered row by row. Its frame: origin at the first marker's centre, x right, y down, z into the paper.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Board {
    /// Markers in a row.
    pub columns: u16,
    /// Rows.
    pub rows: u16,
    /// Number of the first marker.
    pub first: MarkerId,
    /// Length of a black border's outer edge, mm.
    pub tag_mm: f64,
    /// Between the black borders of neighbours, mm.
    pub gap_mm: f64,
}

impl Default for Board {
    /// Six by eight markers on an A4 sheet, numbers that no body carries.
    fn default() -> Self {
        Self { columns: 6, rows: 8, first: MarkerId(500), tag_mm: 22.0, gap_mm: 8.0 }
    }
}

impl Board {
    /// The markers and their centres, mm.
    pub fn markers(&self) -> impl Iterator<Item = (MarkerId, Vector2<f64>)> + '_ {
        let pitch = self.tag_mm + self.gap_mm;
        (0..self.rows * self.columns).map(move |k| {
            let at = Vector2::new(f64::from(k % self.columns), f64::from(k / self.columns)) * pitch;
            (MarkerId(self.first.0 + k), at)
        })
    }

    fn centre(&self, id: MarkerId) -> Option<Vector2<f64>> {
        self.markers().find(|m| m.0 == id).map(|m| m.1)
    }
}

/// Why a stereo camera cannot be calibrated.
#[derive(Debug, Error)]
pub enum BoardError {
    /// A board that cannot be.
    #[error(
        "a board of {columns}x{rows} markers of {tag_mm} mm, {gap_mm} mm apart, from number {first}, cannot be: markers need a gap of a quarter of their size and numbers up to 586"
    )]
    Impossible {
        /// Markers in a row.
        columns: u16,
        /// Rows.
        rows: u16,
        /// First number.
        first: MarkerId,
        /// Size.
        tag_mm: f64,
        /// Gap.
        gap_mm: f64,
    },
    /// Pictures of different sizes.
    #[error(
        "place {place}: the {side} picture is {got:?}, the first one is {expected:?}: all have to come from the same two cameras"
    )]
    Size {
        /// Which pair.
        place: Place,
        /// Which picture.
        side: Side,
        /// Its columns and rows.
        got: [usize; 2],
        /// The first one's.
        expected: [usize; 2],
    },
    /// Too little seen.
    #[error(
        "{usable} of {given} pairs show at least {MARKERS} of the board's markers in both pictures, {PAIRS} are needed: take more, tilted by 20 to 40° in all directions, filling the pictures"
    )]
    TooFew {
        /// Pairs that can be used.
        usable: usize,
        /// Pairs given.
        given: usize,
    },
    /// The pairs leave something open.
    #[error(
        "the pairs leave the {side} camera's focal length open by {percent:.1} %: add pairs with the board tilted by 20 to 40°, about both of its axes"
    )]
    Open {
        /// Which camera.
        side: Side,
        /// Standard error of the focal length.
        percent: f64,
    },
    /// The model does not describe the pictures.
    #[error(
        "place {place} fits the cameras only to {px:.2} px, the others to {typical:.2} px: left and right not taken at the same moment, or the board is bent; leave the pair out or take it again"
    )]
    Misfit {
        /// Which pair.
        place: Place,
        /// Its root mean square residual.
        px: f64,
        /// The median of all pairs.
        typical: f64,
    },
    /// The adjustment found nothing.
    #[error(
        "no pair of lenses explains the pictures: check that left and right are not exchanged, and the board's numbers"
    )]
    NoFit,
    /// A picture cannot be searched for markers.
    #[error(transparent)]
    Marker(#[from] CoarseError),
}

/// Least number of markers in each picture of a pair, and of pairs.
const MARKERS: usize = 6;
const PAIRS: usize = 5;
/// Greatest standard error of a focal length, percent.
const OPEN_PERCENT: f64 = 1.0;
/// Corners are never counted as truer than this, px: what blur and a bent print do to all of them alike is in no residual, and a board that is
/// not tilted turns it into focal length.
const CORNER_PX: f64 = 0.1;

/// A calibrated stereo camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BoardCalibration {
    /// The cameras.
    pub camera: StereoCamera,
    /// Root mean square distance of the corners from where they should be, px.
    pub rms_px: f64,
    /// Standard errors of the lenses' numbers, left and right, in the order of [`Lens`]' fields.
    pub standard_errors: [[f64; 8]; 2],
    /// Pairs used.
    pub used: Vec<Place>,
    /// Pairs that show too little of the board.
    pub left_out: Vec<Place>,
}

/// What the corners say.
pub(super) struct Fit {
    camera: StereoCamera,
    rms_px: f64,
    standard_errors: [[f64; 8]; 2],
    pair_rms_px: Vec<f64>,
}

/// A marker's corners in one picture, and on the board.
pub(super) struct Corner {
    pair: usize,
    side: Side,
    /// On the board, mm.
    model: Vector2<f64>,
    /// In the picture, px.
    pixel: Vector2<f64>,
}

/// Calibrates a stereo camera.
///
/// # Errors
/// [`BoardError`]: what to photograph again.
pub fn calibrate(pairs: &[Pair], board: &Board) -> Result<BoardCalibration, BoardError> {
    let last = u32::from(board.first.0) + u32::from(board.columns) * u32::from(board.rows);
    if !(board.tag_mm > 1.0 && board.gap_mm >= board.tag_mm / 4.0 && board.columns > 1 && board.rows > 1 && last <= 587)
    {
        let Board { columns, rows, first, tag_mm, gap_mm } = *board;
        return Err(BoardError::Impossible { columns, rows, first, tag_mm, gap_mm });
    }
    let size = check_sizes(pairs)?;
    let mut found = Vec::new();
    let (mut used, mut left_out) = (Vec::new(), Vec::new());
    for pair in pairs {
        let both = [corners::find_on(board, &pair.left)?, corners::find_on(board, &pair.right)?];
        if both.iter().all(|f| f.len() >= MARKERS) {
            used.push(pair);
            found.push(both);
        } else {
            left_out.push(pair.place);
        }
    }
    if used.len() < PAIRS {
        return Err(BoardError::TooFew { usable: used.len(), given: pairs.len() });
    }
    let [width, height] = size.map(|s| s as f64);
    // A guess good enough to fit edges within one marker.
    let guess = Lens {
        fx: width,
        fy: width,
        cx: (width - 1.0) / 2.0,
        cy: (height - 1.0) / 2.0,
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
    };
    let mut lenses = [guess; 2];
    let mut result = None;
    for _ in 0..2 {
        let mut all = Vec::new();
        for (k, (pair, found)) in used.iter().zip(&found).enumerate() {
            for (side, picture) in [(Side::Left, &pair.left), (Side::Right, &pair.right)] {
                let lens = &lenses[side as usize];
                all.extend(
                    corners::measure(board, picture, &found[side as usize], lens)
                        .into_iter()
                        .map(|(model, pixel)| Corner { pair: k, side, model, pixel }),
                );
            }
        }
        let fit = adjust::adjust(&all, size, used.len()).ok_or(BoardError::NoFit)?;
        lenses = [fit.camera.left, fit.camera.right];
        result = Some(fit);
    }
    let fit = result.ok_or(BoardError::NoFit)?;
    check(&fit, &used)?;
    Ok(BoardCalibration {
        camera: fit.camera,
        rms_px: fit.rms_px,
        standard_errors: fit.standard_errors,
        used: used.iter().map(|p| p.place).collect(),
        left_out,
    })
}

fn check_sizes(pairs: &[Pair]) -> Result<[usize; 2], BoardError> {
    let first = pairs.first().ok_or(BoardError::TooFew { usable: 0, given: 0 })?;
    let expected = [first.left.width, first.left.height];
    let shape = |g: &Grey| [g.width, g.height];
    for pair in pairs {
        for (side, got) in [(Side::Left, shape(&pair.left)), (Side::Right, shape(&pair.right))] {
            if got != expected {
                return Err(BoardError::Size { place: pair.place, side, got, expected });
            }
        }
    }
    Ok(expected)
}

fn check(fit: &Fit, used: &[&Pair]) -> Result<(), BoardError> {
    let mut sorted = fit.pair_rms_px.clone();
    sorted.sort_by(f64::total_cmp);
    let typical = sorted[sorted.len() / 2];
    for (pair, px) in used.iter().zip(&fit.pair_rms_px) {
        if *px > (5.0 * typical).max(0.5) {
            return Err(BoardError::Misfit { place: pair.place, px: *px, typical });
        }
    }
    let unseen = (CORNER_PX / fit.rms_px).max(1.0);
    for side in Side::BOTH {
        let percent = 100.0 * unseen * fit.standard_errors[side as usize][0] / fit.camera.lens(side).fx;
        if !(percent < OPEN_PERCENT) {
            return Err(BoardError::Open { side, percent });
        }
    }
    Ok(())
}
