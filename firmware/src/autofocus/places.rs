//! Places of a scan, sides of its range, and what is known of them.

use super::exact::added;

/// A place on the scan's grid: the start plus this many half sample steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place(pub i32);

/// All frames of one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Where the frames lie on average, in places: a sweep does not stop on the grid.
    pub x: f64,
    /// The place.
    pub place: Place,
    /// What `x` is off it.
    pub off: f32,
    /// Frames taken there.
    pub frames: u16,
    /// Mean of their values.
    pub mean: f64,
}

impl Cell {
    /// How far it lies past another one, in places; between places themselves that costs no software floats.
    pub fn past(&self, other: Cell) -> f64 {
        let whole = self.off == 0.0 && other.off == 0.0;
        if whole { f64::from(self.place.0 - other.place.0) } else { added(self.x, -other.x) }
    }
}

/// The mean level over some frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Level {
    /// Their mean.
    pub mean: f64,
    /// How many.
    pub frames: u32,
}

/// A side of the range, or a direction of travel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Towards smaller z.
    Low,
    /// Towards larger z.
    High,
}

impl Side {
    /// −1 or 1.
    pub fn sign(self) -> i32 {
        match self {
            Side::Low => -1,
            Side::High => 1,
        }
    }

    /// The opposite side.
    pub fn other(self) -> Self {
        match self {
            Side::Low => Side::High,
            Side::High => Side::Low,
        }
    }
}
