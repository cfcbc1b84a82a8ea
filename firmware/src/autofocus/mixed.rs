//! The chapter's mixed method, literally: steepest ascent to a maximum, then a blind search of a trap radius to both
//! sides. It has no sense of noise; it is here for comparison, its return counted like any other's.

use super::curve::{Curve, Place, STRIDE, Side};
use super::search::{Lengths, Next, Search};

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    Probe,
    Ascend(Side),
    Blind { from: Place, to: Place },
    Over,
}

/// State of the mixed method.
#[derive(Clone, Debug)]
pub struct Mixed {
    lengths: Lengths,
    stage: Stage,
    last: f64,
}

impl Mixed {
    /// A search with these lengths.
    pub fn new(lengths: Lengths) -> Self {
        Self { lengths, stage: Stage::Probe, last: 0.0 }
    }

    fn on(&mut self, curve: &Curve, side: Side, value: f64) -> Next {
        self.stage = Stage::Ascend(side);
        self.last = value;
        let to = (curve.here().0 + side.sign() * STRIDE).clamp(curve.limit(Side::Low).0, curve.limit(Side::High).0);
        Next::Sample(Place(to))
    }
}

impl Search for Mixed {
    fn next(&mut self, curve: &Curve) -> Next {
        let here = curve.here();
        let Some(value) = curve.at(here).map(|c| c.mean) else { return Next::Enough };
        match self.stage {
            Stage::Probe => {
                let end = self.lengths.probe.min(curve.limit(Side::High).0);
                if here.0 < end {
                    return Next::Sample(Place((here.0 + STRIDE).min(end)));
                }
                if value > curve.reference() {
                    self.on(curve, Side::High, value)
                } else {
                    self.on(curve, Side::Low, value)
                }
            }
            Stage::Ascend(side) => {
                // Back from a probe in vain: the slope is followed from the start on.
                let back = side == Side::Low && here.0 > 0;
                let ahead = here.0 * side.sign() < curve.limit(side).0 * side.sign();
                if (back || value >= self.last) && ahead {
                    return self.on(curve, side, if back { f64::MIN } else { value });
                }
                let middle = Place(here.0 - side.sign() * STRIDE);
                let near = Place(middle.0 + side.sign() * self.lengths.trap);
                let far = Place(middle.0 - side.sign() * self.lengths.trap);
                let limit = |p: Place| Place(p.0.clamp(curve.limit(Side::Low).0, curve.limit(Side::High).0));
                self.stage = Stage::Blind { from: limit(near), to: limit(far) };
                self.next(curve)
            }
            Stage::Blind { from, to } => {
                if here != from {
                    return Next::Sample(Place(here.0 + (from.0 - here.0).clamp(-STRIDE, STRIDE)));
                }
                self.stage = if from == to { Stage::Over } else { Stage::Blind { from: to, to } };
                self.next(curve)
            }
            Stage::Over => Next::Enough,
        }
    }
}
