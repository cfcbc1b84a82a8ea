//! Jerk-limited paths: distance as a function of time, in stretches of constant jerk.
//!
//! After Biagiotti & Melchiorri, *Trajectory Planning for Automatic Machines and Robots* (Springer 2008), 3.4: seven stretches
//! from rest to rest. Here the durations are rounded up to whole ticks first and the jerk follows from them, so that a path is
//! told by a few integers and keeps every limit.

use super::math::{cbrt, ceil_ticks, sqrt};
use super::stretch::{State, Stretch};
use heapless::Vec;

/// Largest speed, acceleration and jerk, in units of the path per tick, tick², tick³.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Speed.
    pub v: f64,
    /// Acceleration.
    pub a: f64,
    /// Jerk.
    pub j: f64,
}

/// Stretches of a path.
pub const STRETCHES: usize = 7;

/// Longest duration of a stretch that is not cruise, ticks: 25 s.
const LONGEST_RAMP: u64 = (1 << 31) - 1;

/// Distance over time, never decreasing.
#[derive(Clone, Debug, Default)]
pub struct Path {
    stretches: Vec<Stretch, STRETCHES>,
}

impl Path {
    /// From rest to rest over `length`. `None` when a ramp would last longer than 25 s.
    pub fn rest_to_rest(length: f64, limits: Limits) -> Option<Self> {
        let (tj, ta, tv) = durations(length, limits);
        if tj.max(ta) > LONGEST_RAMP as f64 || tv > 1e15 {
            return None;
        }
        Some(Self::of_durations(length, ceil_ticks(tj).max(1), ceil_ticks(ta), ceil_ticks(tv)))
    }

    /// Over `length` with `tj` ticks of jerk, `ta` of constant acceleration, `tv` of constant speed.
    pub fn of_durations(length: f64, tj: u64, ta: u64, tv: u64) -> Self {
        let (j, a, v) = (tj as f64, ta as f64, tv as f64);
        let top = length / (2.0 * j + a + v);
        let acceleration = top / (j + a);
        let jerk = acceleration / j;
        // Distances at the borders, from whichever end they are nearer to.
        let d1 = jerk * j * j * j / 6.0;
        let v1 = acceleration * j / 2.0;
        let d2 = d1 + v1 * a + acceleration * a * a / 2.0;
        let v2 = v1 + acceleration * a;
        let d3 = top * (2.0 * j + a) / 2.0;
        let mut path = Self::default();
        path.add(Stretch { ticks: tj, p: 0.0, v: 0.0, a: 0.0, j: jerk, end: d1 });
        path.add(Stretch { ticks: ta, p: d1, v: v1, a: acceleration, j: 0.0, end: d2 });
        path.add(Stretch { ticks: tj, p: d2, v: v2, a: acceleration, j: -jerk, end: d3 });
        path.add(Stretch { ticks: tv, p: d3, v: top, a: 0.0, j: 0.0, end: length - d3 });
        path.add(Stretch { ticks: tj, p: length - d3, v: top, a: 0.0, j: -jerk, end: length - d2 });
        path.add(Stretch { ticks: ta, p: length - d2, v: v2, a: -acceleration, j: 0.0, end: length - d1 });
        path.add(Stretch { ticks: tj, p: length - d1, v: v1, a: -acceleration, j: jerk, end: length });
        path
    }

    /// From `from` at its acceleration to constant speed `v`, within the limits of acceleration and jerk.
    pub fn ramp(&mut self, from: State, v: f64, limits: Limits) -> Option<()> {
        // Speed reached if the acceleration were let go of at once.
        let free = from.v + from.a * from.a.abs() / (2.0 * limits.j);
        let sign = if v >= free { 1.0 } else { -1.0 };
        let a0 = from.a * sign;
        let gain = (v - from.v) * sign;
        let mut peak = sqrt(limits.j * gain + a0 * a0 / 2.0).max(a0).max(0.0);
        let mut hold = 0.0;
        if peak > limits.a {
            peak = limits.a.max(a0);
            hold = ((gain - (peak * peak - a0 * a0 / 2.0) / limits.j) / peak).max(0.0);
        }
        let (t1, t2, t3) = ((peak - a0) / limits.j, hold, peak / limits.j);
        if t1.max(t2).max(t3) > LONGEST_RAMP as f64 {
            return None;
        }
        let (t1, t2, t3) = (ceil_ticks(t1), ceil_ticks(t2), ceil_ticks(t3).max(1));
        let (d1, d2, d3) = (t1 as f64, t2 as f64, t3 as f64);
        // The durations are whole ticks now: the peak that reaches v exactly.
        let peak = (v - from.v - from.a * d1 / 2.0) / (d1 / 2.0 + d2 + d3 / 2.0);
        let j1 = if t1 > 0 { (peak - from.a) / d1 } else { 0.0 };
        let mut at = from;
        at = self.go(at, t1, j1);
        at.a = peak;
        at = self.go(at, t2, 0.0);
        at.a = peak;
        at = self.go(at, t3, -peak / d3);
        at.v = v;
        self.settle(at.p);
        Some(())
    }

    /// On at constant speed.
    pub fn cruise(&mut self, from: State, ticks: u64) {
        let end = from.p + from.v * ticks as f64;
        self.add(Stretch { ticks, p: from.p, v: from.v, a: 0.0, j: 0.0, end });
    }

    fn go(&mut self, from: State, ticks: u64, j: f64) -> State {
        let mut stretch = Stretch { ticks, p: from.p, v: from.v, a: from.a, j, end: 0.0 };
        let to = stretch.state(ticks);
        stretch.end = to.p;
        self.add(stretch);
        to
    }

    fn settle(&mut self, end: f64) {
        if let Some(last) = self.stretches.last_mut() {
            last.end = end;
        }
    }

    fn add(&mut self, stretch: Stretch) {
        if stretch.ticks > 0 {
            // Seven stretches hold every path that is made here; one more would be a mistake that the total would show.
            let _ = self.stretches.push(stretch);
        }
    }

    /// The stretches.
    pub fn stretches(&self) -> &[Stretch] {
        &self.stretches
    }

    /// Ticks in all.
    pub fn ticks(&self) -> u64 {
        self.stretches.iter().map(|s| s.ticks).sum()
    }

    /// Distance in all.
    pub fn length(&self) -> f64 {
        self.stretches.last().map_or(0.0, |s| s.end)
    }

    /// Where the path is `ticks` after its beginning.
    pub fn state(&self, ticks: u64) -> State {
        let mut left = ticks;
        for s in &self.stretches {
            if left < s.ticks {
                return s.state(left);
            }
            left -= s.ticks;
        }
        State { p: self.length(), v: 0.0, a: 0.0 }
    }
}

/// Durations of jerk, constant acceleration and constant speed, ticks.
fn durations(length: f64, limits: Limits) -> (f64, f64, f64) {
    let Limits { v, a, j } = limits;
    let (tj, ta) = if v * j < a * a { (sqrt(v / j), 0.0) } else { (a / j, v / a - a / j) };
    let ramps = v * (2.0 * tj + ta);
    if ramps <= length {
        return (tj, ta, (length - ramps) / v);
    }
    // No cruise: the top speed that just fits.
    let b = a * a / j;
    let top = (sqrt(b * b + 4.0 * a * length) - b) / 2.0;
    if top * j < a * a { (cbrt(length / (2.0 * j)), 0.0, 0.0) } else { (a / j, top / a - a / j, 0.0) }
}
