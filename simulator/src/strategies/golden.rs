//! Golden-section search (Kiefer 1953).

use super::{on_grid, range, value};
use parfocal_firmware::autofocus::curve::{Curve, Place, STRIDE};
use parfocal_firmware::autofocus::search::{Next, Search};

/// 1/φ.
const SECTION: f64 = 0.618_033_988_749_894_9;

/// State of a golden-section search.
#[derive(Clone, Debug, Default)]
pub struct Golden {
    interval: Option<(f64, f64)>,
    /// The inner point that is known and its value, and the one that is awaited.
    known: Option<(f64, f64)>,
    awaited: Option<f64>,
}

impl Golden {
    fn ask(&mut self, at: f64) -> Next {
        self.awaited = Some(at);
        Next::Sample(on_grid(at))
    }
}

impl Search for Golden {
    fn next(&mut self, curve: &Curve) -> Next {
        let Some((low, high)) = self.interval else {
            let (low, high) = range(curve);
            self.interval = Some((low, high));
            return self.ask(high - SECTION * (high - low));
        };
        let value = value(curve);
        let Some(at) = self.awaited else { return Next::Enough };
        let Some((other, known)) = self.known else {
            self.known = Some((at, value));
            return self.ask(low + SECTION * (high - low));
        };
        let (left, right) = if at < other { ((at, value), (other, known)) } else { ((other, known), (at, value)) };
        let (interval, keep) = if left.1 > right.1 { ((low, right.0), left) } else { ((left.0, high), right) };
        self.interval = Some(interval);
        self.known = Some(keep);
        let width = interval.1 - interval.0;
        if width <= 2.0 * f64::from(STRIDE) {
            return Next::Enough;
        }
        let next = interval.0 + interval.1 - keep.0;
        if on_grid(next) == Place(curve.here().0) { Next::Enough } else { self.ask(next) }
    }
}
