//! The whole range in coarse steps, then every step around the coarse maximum.

use super::{range, value};
use parfocal_firmware::autofocus::curve::{Curve, Place, STRIDE};
use parfocal_firmware::autofocus::search::{Next, Search};

/// Coarse steps, in places: 5 µm at the usual sample step.
const COARSE: i32 = 10 * STRIDE;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Stage {
    #[default]
    Begin,
    Coarse,
    Fine {
        to: i32,
    },
}

/// State of a coarse-to-fine search.
#[derive(Clone, Debug, Default)]
pub struct CoarseFine {
    stage: Stage,
    best: Option<(i32, f64)>,
}

impl Search for CoarseFine {
    fn next(&mut self, curve: &Curve) -> Next {
        let (low, high) = range(curve);
        let (low, high, here) = (low as i32, high as i32, curve.here().0);
        let value = value(curve);
        match self.stage {
            Stage::Begin => {
                self.stage = Stage::Coarse;
                Next::Sample(Place(low))
            }
            Stage::Coarse => {
                if self.best.is_none_or(|(_, b)| value > b) {
                    self.best = Some((here, value));
                }
                if here + COARSE <= high {
                    return Next::Sample(Place(here + COARSE));
                }
                let best = self.best.map_or(here, |(p, _)| p);
                self.stage = Stage::Fine { to: (best - COARSE).max(low) };
                Next::Sample(Place((best + COARSE).min(high)))
            }
            Stage::Fine { to } if here - STRIDE >= to => Next::Sample(Place(here - STRIDE)),
            Stage::Fine { .. } => Next::Enough,
        }
    }
}
