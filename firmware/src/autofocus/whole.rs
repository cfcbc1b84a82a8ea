//! The whole range: to the nearer end first, then to the other one.

use super::curve::{Curve, Place, STRIDE, Side};
use super::refine::Refine;
use super::search::{Lengths, Next, Search};

/// Frames at the start, to learn the noise.
const SENSE: u32 = 8;

/// The same before a sweep, which sees light that drifts only there.
const SENSE_SWEEPING: u32 = 32;

/// State of a scan of the whole range.
#[derive(Clone, Debug)]
pub struct Whole {
    lengths: Lengths,
    refine: Option<Refine>,
}

impl Whole {
    /// A scan of everything.
    pub fn new(lengths: Lengths) -> Self {
        Self { lengths, refine: None }
    }
}

impl Search for Whole {
    fn next(&mut self, curve: &Curve) -> Next {
        if let Some(refine) = &mut self.refine {
            return refine.next(curve);
        }
        let sense = if self.lengths.sweeping { SENSE_SWEEPING } else { SENSE };
        if curve.frames() < if curve.noise().is_none() { 3 } else { sense } {
            return Next::Sample(Place(0));
        }
        let nearer = if curve.limit(Side::High).0 < -curve.limit(Side::Low).0 { Side::High } else { Side::Low };
        for side in [nearer, nearer.other()] {
            if curve.ahead(side) >= STRIDE {
                return Next::Sample(Place(curve.seen(side).0 + side.sign() * STRIDE));
            }
        }
        if self.lengths.sweeping {
            return Next::Enough;
        }
        self.refine.insert(Refine::new(self.lengths.trap)).next(curve)
    }
}
