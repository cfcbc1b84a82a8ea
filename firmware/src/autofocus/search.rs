//! How to look for a peak: one small trait, one state machine each behind it.

use super::climb::Climb;
use super::curve::{Curve, Place};
use super::mixed::Mixed;
use super::whole::Whole;
use parfocal_protocol::autofocus::{Mode, ScanParameters, Strategy};

/// Where a search wants its next frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// A frame at this place; the same place again means one more frame.
    Sample(Place),
    /// Not decided yet: there is more to work out than a slice holds. Ask again, with the same curve.
    Thinking,
    /// Enough is seen.
    Enough,
}

/// A state machine that is asked after each value where the next frame should be. The curve holds the value at
/// [`Curve::here`]. In a sweep the place only says which way to go on.
pub trait Search {
    /// What to look at next.
    fn next(&mut self, curve: &Curve) -> Next;
}

/// Lengths that searches go by, in places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lengths {
    /// How far past the best to look.
    pub trap: i32,
    /// The first probe for the direction.
    pub probe: i32,
    /// Whether frames are taken at constant speed, so that no place can be visited twice at will.
    pub sweeping: bool,
}

impl Lengths {
    /// Of a scan with these parameters on this curve.
    pub fn new(parameters: &ScanParameters, curve: &Curve) -> Self {
        Self {
            trap: curve.places(parameters.trap),
            probe: curve.places(parameters.probe),
            sweeping: parameters.mode == Mode::Sweep,
        }
    }
}

/// The searches that a board knows by name.
#[derive(Clone, Debug)]
pub enum Named {
    /// See [`Strategy::Climb`].
    Climb(Climb),
    /// See [`Strategy::Mixed`].
    Mixed(Mixed),
    /// See [`Strategy::Scan`].
    Whole(Whole),
}

impl Named {
    /// The search of this name.
    pub fn new(strategy: Strategy, lengths: Lengths) -> Self {
        match strategy {
            Strategy::Climb => Self::Climb(Climb::new(lengths)),
            Strategy::Mixed => Self::Mixed(Mixed::new(lengths)),
            Strategy::Scan => Self::Whole(Whole::new(lengths)),
        }
    }
}

impl Search for Named {
    fn next(&mut self, curve: &Curve) -> Next {
        match self {
            Self::Climb(search) => search.next(curve),
            Self::Mixed(search) => search.next(curve),
            Self::Whole(search) => search.next(curve),
        }
    }
}
