//! Brent's minimisation without derivatives (Brent 1973, chapter 5), turned upside down; as in Micro-Manager's
//! OughtaFocus, over the whole range.

use super::{on_grid, range, value};
use parfocal_firmware::autofocus::curve::{Curve, STRIDE};
use parfocal_firmware::autofocus::search::{Next, Search};

/// (3 − √5) / 2.
const GOLDEN: f64 = 0.381_966_011_250_105_1;

/// Samples at most.
const LIMIT: u32 = 60;

#[derive(Clone, Copy, Debug)]
struct State {
    low: f64,
    high: f64,
    /// Best, second best and third best place, with −Φ.
    x: (f64, f64),
    w: (f64, f64),
    v: (f64, f64),
    step: f64,
    before: f64,
}

/// State of Brent's method.
#[derive(Clone, Debug, Default)]
pub struct Brent {
    interval: Option<(f64, f64)>,
    state: Option<State>,
    awaited: f64,
    samples: u32,
}

impl Brent {
    fn ask(&mut self, at: f64) -> Next {
        self.awaited = at;
        self.samples += 1;
        Next::Sample(on_grid(at))
    }
}

impl State {
    /// Takes in a sample and narrows the bracket.
    fn take(&mut self, u: (f64, f64)) {
        if u.1 <= self.x.1 {
            if u.0 >= self.x.0 {
                self.low = self.x.0
            } else {
                self.high = self.x.0
            }
            (self.v, self.w, self.x) = (self.w, self.x, u);
        } else {
            if u.0 < self.x.0 {
                self.low = u.0
            } else {
                self.high = u.0
            }
            if u.1 <= self.w.1 || self.w.0 == self.x.0 {
                (self.v, self.w) = (self.w, u);
            } else if u.1 <= self.v.1 || self.v.0 == self.x.0 || self.v.0 == self.w.0 {
                self.v = u;
            }
        }
    }

    /// The next place to look at; `None` when the bracket is as narrow as the tolerance.
    fn propose(&mut self) -> Option<f64> {
        let tolerance = f64::from(STRIDE);
        let middle = 0.5 * (self.low + self.high);
        let (x, w, v) = (self.x, self.w, self.v);
        if (x.0 - middle).abs() <= 2.0 * tolerance - 0.5 * (self.high - self.low) {
            return None;
        }
        let golden = |s: &mut Self| {
            s.before = if x.0 < middle { s.high - x.0 } else { s.low - x.0 };
            s.step = GOLDEN * s.before;
        };
        if self.before.abs() > tolerance {
            // A parabola through the three best.
            let r = (x.0 - w.0) * (x.1 - v.1);
            let q = (x.0 - v.0) * (x.1 - w.1);
            let p = (x.0 - v.0) * q - (x.0 - w.0) * r;
            let q = 2.0 * (q - r);
            let (p, q) = if q > 0.0 { (-p, q) } else { (p, -q) };
            let before = core::mem::replace(&mut self.before, self.step);
            let inside = p > q * (self.low - x.0) && p < q * (self.high - x.0);
            if p.abs() < (0.5 * q * before).abs() && inside {
                self.step = p / q;
                let u = x.0 + self.step;
                if u - self.low < 2.0 * tolerance || self.high - u < 2.0 * tolerance {
                    self.step = if x.0 < middle { tolerance } else { -tolerance };
                }
            } else {
                golden(self);
            }
        } else {
            golden(self);
        }
        let least = if self.step >= 0.0 { tolerance } else { -tolerance };
        Some(x.0 + if self.step.abs() >= tolerance { self.step } else { least })
    }
}

impl Search for Brent {
    fn next(&mut self, curve: &Curve) -> Next {
        let Some((low, high)) = self.interval else {
            let (low, high) = range(curve);
            self.interval = Some((low, high));
            return self.ask(low + GOLDEN * (high - low));
        };
        let sample = (self.awaited, -value(curve));
        let mut state = match self.state {
            None => State { low, high, x: sample, w: sample, v: sample, step: 0.0, before: 0.0 },
            Some(mut state) => {
                state.take(sample);
                state
            }
        };
        let next = state.propose();
        self.state = Some(state);
        match next {
            Some(at) if self.samples < LIMIT => self.ask(at),
            _ => Next::Enough,
        }
    }
}
