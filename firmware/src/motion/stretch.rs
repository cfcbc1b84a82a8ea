//! A stretch of constant jerk, in the steps of one axis.

use super::math::floor;
use super::phase::{Cubic, Phase, Shape};

/// A stretch of constant jerk.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stretch {
    /// How long, ticks.
    pub ticks: u64,
    /// Distance, speed and acceleration at its beginning.
    pub p: f64,
    /// Speed, units per tick.
    pub v: f64,
    /// Acceleration.
    pub a: f64,
    /// Jerk.
    pub j: f64,
    /// Distance at its end.
    pub end: f64,
}

/// Where a path is at some tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Distance.
    pub p: f64,
    /// Speed.
    pub v: f64,
    /// Acceleration.
    pub a: f64,
}

/// An edge so near to the end of a motion, in steps, is not made: there the path is so slow that its time means nothing.
const REST: f64 = 1.0 / 4096.0;

/// Counts passed at a distance, of a motion that goes on, or rests there.
pub fn count(distance: f64, rests: bool) -> f64 {
    floor(distance + 0.5 - if rests { REST } else { 0.0 }).max(0.0)
}

impl Stretch {
    /// Where the path is `ticks` after the stretch's beginning.
    pub fn state(&self, ticks: u64) -> State {
        let t = ticks as f64;
        State {
            p: self.p + t * (self.v + t * (self.a / 2.0 + t * self.j / 6.0)),
            v: self.v + t * (self.a + t * self.j / 2.0),
            a: self.a + t * self.j,
        }
    }

    fn is_even(&self) -> bool {
        self.a == 0.0 && self.j == 0.0
    }

    /// The cubic of one axis with `scale` steps per unit of the path, and which way it is counted.
    fn bend(&self, scale: f64) -> Bend {
        let t = self.ticks as f64;
        let (v, a, j) = (self.v * scale, self.a * scale, self.j * scale);
        let (v_end, a_end) = (v + t * (a + t * j / 2.0), a + t * j);
        let reversed = v_end < v;
        let shift = 64 - self.ticks.leading_zeros();
        let unit = (1u64 << shift.min(63)) as f64;
        // Backwards in time from the end: the speed is the same, the acceleration's sign turns, the jerk's stays.
        let (v, a) = if reversed { (v_end.max(0.0), -a_end) } else { (v, a) };
        let c = [v * unit, a * unit * unit / 2.0, j * unit * unit * unit / 6.0];
        Bend { reversed, shift, unit, c }
    }

    /// Ticks after the stretch's beginning at which an axis is `steps` on its way from there; within the stretch.
    pub fn time_of(&self, scale: f64, steps: f64) -> f64 {
        if self.is_even() {
            return steps / (self.v * scale);
        }
        self.time_in(&self.bend(scale), scale, steps)
    }

    fn time_in(&self, bend: &Bend, scale: f64, steps: f64) -> f64 {
        let Bend { reversed, unit, c, .. } = *bend;
        let t = self.ticks as f64;
        let whole = (self.end - self.p) * scale;
        let y = solve(c, if reversed { whole - steps } else { steps }, t / unit);
        if reversed { t - y * unit } else { y * unit }
    }

    /// The stretch as an axis plays it: `scale` steps per unit of the path, which starts `offset` steps off a count, beginning at
    /// tick `begin`, the counts passed before and behind it. `None` when no edge lies in it.
    pub fn phase(&self, scale: f64, offset: f64, begin: u64, before: f64, behind: f64, up: bool) -> Option<Phase> {
        let steps = (behind - before) as u32;
        if steps == 0 {
            return None;
        }
        let near = before + 0.5 - (self.p * scale + offset);
        let (first, shape) = if self.is_even() {
            let interval = 1.0 / (self.v * scale);
            (near * interval, Shape::Even { interval: fixed(interval) })
        } else {
            let bend = self.bend(scale);
            let Bend { reversed, shift, c, .. } = bend;
            let from_end = self.end * scale + offset - (behind - 0.5);
            let cubic = Cubic {
                ticks: self.ticks as u32,
                shift,
                reversed,
                near: (if reversed { from_end } else { near } * FIXED) as i64,
                c: c.map(|c| (c * FIXED) as i64),
                f: c.map(|c| c as f32),
            };
            (self.time_in(&bend, scale, near), Shape::Curved(cubic))
        };
        Some(Phase { begin, ticks: self.ticks, steps, up, first: fixed(first.max(0.0)), shape })
    }
}

struct Bend {
    reversed: bool,
    shift: u32,
    unit: f64,
    c: [f64; 3],
}

/// 2³².
const FIXED: f64 = 4_294_967_296.0;

fn fixed(ticks: f64) -> u64 {
    (ticks * FIXED + 0.5) as u64
}

/// y in 0..=end at which c₁y + c₂y² + c₃y³, which does not decrease there, reaches `target`: bisection in single precision, then
/// Newton.
fn solve(c: [f64; 3], target: f64, end: f64) -> f64 {
    let [c1, c2, c3] = c;
    let [f1, f2, f3] = c.map(|c| c as f32);
    let (mut low, mut high) = (0.0f32, end as f32);
    for _ in 0..20 {
        let y = 0.5 * (low + high);
        if y * (f1 + y * (f2 + y * f3)) < target as f32 { low = y } else { high = y }
    }
    let mut y = f64::from(high);
    for _ in 0..6 {
        let off = target - y * (c1 + y * (c2 + y * c3));
        let slope = c1 + y * (2.0 * c2 + y * 3.0 * c3);
        if slope <= 0.0 {
            break;
        }
        let change = off / slope;
        // Not `clamp`: its panic would bring the formatting of floats into the firmware, 25 KiB.
        let next = y + change;
        y = if !(next > 0.0) {
            0.0
        } else if next < end {
            next
        } else {
            end
        };
        // What Newton leaves of a change is its square times s''/2s', and that is 1/y at most.
        if change * change < end * 1e-11 * y {
            break;
        }
    }
    y
}
