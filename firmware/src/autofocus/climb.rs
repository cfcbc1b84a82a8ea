//! The default search: probe for the uphill direction, one pass uphill, a trap radius past the best on both sides.

use super::curve::{Curve, Place};
use super::{Next, Search};

/// State of a climb.
#[derive(Clone, Debug)]
pub struct Climb {
    trap: i32,
    probe: i32,
    heading: i32,
    probing: bool,
}

impl Climb {
    /// A climb with the trap radius and the probe in places.
    pub fn new(trap: i32, probe: i32) -> Self {
        Self { trap, probe, heading: 1, probing: true }
    }
}

impl Search for Climb {
    fn next(&mut self, curve: &Curve, here: Place) -> Next {
        let Some(best) = curve.best() else { return Next::Sample(here) };
        if self.probing {
            let probed = curve.highest().0;
            if probed < self.probe && probed < curve.last().0 {
                return Next::Sample(Place(probed + 1));
            }
            self.probing = false;
            if best.place.0 <= 0 {
                self.heading = -1;
            }
        }
        for heading in [self.heading, -self.heading] {
            let (seen, goal) = if heading > 0 {
                (curve.highest().0, (best.place.0 + self.trap).min(curve.last().0))
            } else {
                (curve.lowest().0, (best.place.0 - self.trap).max(curve.first().0))
            };
            if (goal - seen) * heading > 0 {
                self.heading = heading;
                return Next::Sample(Place(seen + heading));
            }
        }
        Next::Enough
    }
}
