//! What a scan has seen: the focus curve, in bounded memory.

use super::noise::{Noise, Trend};
use parfocal_protocol::units::{FocusValue, Nanometres};

/// Cells around the present position that a curve keeps; what lies further back is forgotten.
pub const CELLS: usize = 512;
/// Places in a sample step: the way back may sample between the places of the way out.
pub const STRIDE: i32 = 2;

/// A place on the scan's grid: the start plus this many sample steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place(pub i32);

/// All frames of one place, summed up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Where on the grid.
    pub place: Place,
    /// Frames taken there; 0 for an empty cell.
    pub frames: u16,
    /// How far the frames lie from the place on average, nm (a sweep does not stop on the grid).
    pub off: f32,
    /// Mean of their values.
    pub mean: f64,
}

const EMPTY: Cell = Cell { place: Place(i32::MIN), frames: 0, off: 0.0, mean: 0.0 };

/// The focus curve on a grid through the start.
#[derive(Clone, Debug)]
pub struct Curve {
    origin: i32,
    step: i32,
    first: Place,
    last: Place,
    cells: [Cell; CELLS],
    lowest: Place,
    highest: Place,
    frames: u32,
    reference: f64,
    noise: Noise,
    trend: Trend,
}

impl Curve {
    /// An empty curve from `low` to `high`, whose grid goes through `origin`. `step` must be positive.
    pub fn new(origin: Nanometres, low: Nanometres, high: Nanometres, step: Nanometres) -> Self {
        Self {
            origin: origin.0,
            step: step.0 / STRIDE,
            first: Place((low.0 - origin.0) / step.0 * STRIDE),
            last: Place((high.0 - origin.0) / step.0 * STRIDE),
            cells: [EMPTY; CELLS],
            lowest: Place(0),
            highest: Place(0),
            frames: 0,
            reference: 0.0,
            noise: Noise::default(),
            trend: Trend::default(),
        }
    }

    /// The lowest place of the range.
    pub fn first(&self) -> Place {
        self.first
    }

    /// The highest place of the range.
    pub fn last(&self) -> Place {
        self.last
    }

    /// The lowest place that was visited.
    pub fn lowest(&self) -> Place {
        self.lowest
    }

    /// The highest place that was visited.
    pub fn highest(&self) -> Place {
        self.highest
    }

    /// Frames taken.
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// Where a place lies.
    pub fn position(&self, place: Place) -> Nanometres {
        Nanometres(self.origin + place.0 * self.step)
    }

    /// The place nearest to a position, within the range.
    pub fn place(&self, z: Nanometres) -> Place {
        let off = z.0 - self.origin;
        let half = if off < 0 { -self.step / 2 } else { self.step / 2 };
        Place((off + half) / self.step).clamp(self.first, self.last)
    }

    /// A length in whole places, rounded up.
    pub fn places(&self, length: Nanometres) -> i32 {
        (length.0 + self.step - 1) / self.step
    }

    /// Takes in one frame.
    pub fn add(&mut self, z: Nanometres, value: FocusValue) {
        let place = self.place(z);
        let off = (z.0 - self.position(place).0) as f32;
        if self.frames == 0 {
            self.reference = value.0;
        }
        self.trend.add(f64::from(z.0 - self.origin) / f64::from(self.step), value.0 - self.reference);
        let cell = &mut self.cells[index(place)];
        if cell.place != place || cell.frames == 0 {
            *cell = Cell { place, frames: 1, off, mean: value.0 };
        } else if cell.frames < u16::MAX {
            cell.frames += 1;
            let before = cell.mean;
            cell.mean += (value.0 - cell.mean) / f64::from(cell.frames);
            let scale = if cell.mean < 0.0 { -cell.mean } else { cell.mean };
            self.noise.add(value.0, before, cell.mean, scale);
            cell.off += (off - cell.off) / f32::from(cell.frames);
        }
        self.lowest = self.lowest.min(place);
        self.highest = self.highest.max(place);
        self.frames += 1;
    }

    /// Noise of one frame, relative.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }

    /// The first value.
    pub fn reference(&self) -> f64 {
        self.reference
    }

    /// The line through everything seen.
    pub fn trend(&self) -> &Trend {
        &self.trend
    }

    /// Mean over the places from `from` to `to` that are known, and the frames in it.
    pub fn mean(&self, from: i32, to: i32) -> (f64, u32) {
        let (mut sum, mut frames) = (0.0, 0);
        for cell in (from..=to).filter_map(|p| self.at(Place(p))) {
            sum += cell.mean * f64::from(cell.frames);
            frames += u32::from(cell.frames);
        }
        (if frames > 0 { sum / f64::from(frames) } else { 0.0 }, frames)
    }

    /// What is known of a place; `None` where no frame was taken or where it was forgotten.
    pub fn at(&self, place: Place) -> Option<&Cell> {
        let cell = &self.cells[index(place)];
        (cell.frames > 0 && cell.place == place).then_some(cell)
    }

    /// The largest mean that is still known.
    pub fn best(&self) -> Option<&Cell> {
        self.cells.iter().filter(|c| c.frames > 0).reduce(|a, b| if b.mean > a.mean { b } else { a })
    }
}

fn index(place: Place) -> usize {
    place.0.rem_euclid(CELLS as i32) as usize
}
