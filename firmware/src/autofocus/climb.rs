//! The default search: probe for the uphill direction, one pass uphill, a trap radius past the best on both sides.

use super::curve::{Curve, Place, STRIDE};
use super::noise::root;
use super::peak::{self, smooth};
use super::{Next, Search};

#[derive(Clone, Copy, Debug)]
pub struct Tuning { pub sense: u32, pub stay: u32, pub per: u16, pub turn: f64, pub fall: f64, pub quiet: f64, pub base: i32, pub extra: u16, pub bias: f64, pub plaus: f64, pub turn_at: i32, pub wide: f64 }
pub const TUNING: Tuning = Tuning { sense: 32, stay: 32, per: 2, turn: 2.5, fall: 5.5, quiet: 2e-4, base: 90, extra: 12, bias: 0.5, plaus: 3.0, turn_at: 0, wide: 4.0 };

/// State of a climb.
#[derive(Clone, Debug)]
pub struct Climb {
    pub tuning: Tuning,
    trap: i32,
    probe: i32,
    heading: i32,
    best: Option<(i32, f64)>,
    stage: Stage,
    travelled: i32,
    last: i32,
    turned: bool,
    ends: [(f64, u32); 2],
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage { Walk, Refine { goal: i32, rounds: u8 } }

impl Climb {
    /// A climb with the trap radius and the probe in places.
    pub fn new(trap: i32, probe: i32) -> Self {
        Self { tuning: TUNING, trap, probe, heading: 0, best: None, stage: Stage::Walk, travelled: 0, last: 0, turned: false, ends: [(0.0, 0); 2] }
    }

    pub fn best_place(&self) -> Option<i32> { self.best.map(|b| b.0) }
    fn budget(&self, curve: &Curve) -> i32 {
        self.tuning.base + 2 * self.travelled / STRIDE - curve.frames() as i32
    }

    fn take_in(&mut self, curve: &Curve, here: i32, sigma: f64) {
        let h = if sigma > 0.0 { STRIDE } else { 0 };
        for p in here - h..=here + h {
            let v = if sigma > 0.0 { smooth(curve, p) } else { curve.at(Place(p)).map(|c| c.mean) };
            let Some(v) = v else { continue };
            match self.best { Some((q, b)) if q != p && b >= v => {}, _ => self.best = Some((p, v)) }
        }
    }

    fn done(&self, curve: &Curve, side: i32, sigma: f64) -> bool {
        let Some((b, v)) = self.best else { return false };
        let seen = if side > 0 { curve.highest().0 } else { curve.lowest().0 };
        let end = if side > 0 { curve.last().0 } else { curve.first().0 };
        if seen == end { return true; }
        if (seen - b) * side < self.trap { return false; }
        self.fell(curve, side, sigma)
    }

    fn end(&self, curve: &Curve, here: i32, side: i32, sigma: f64) -> (f64, u32) {
        let far = here + if sigma > 0.0 { 7 * STRIDE * side } else { 0 };
        curve.mean(here.min(far), here.max(far))
    }

    /// Whether the values fall from the best to the end seen on one side, beyond doubt.
    fn fell(&self, curve: &Curve, side: i32, sigma: f64) -> bool {
        let Some((b, v)) = self.best else { return false };
        let (m, n) = self.ends[usize::from(side > 0)];
        if n == 0 { return false; }
        let s = sigma * v.max(-v);
        let e = s * root(1.0 / f64::from(n) + 0.4 / f64::from(self.tuning.per));
        if v - m > self.tuning.fall * e { return true; }
        let (w, k) = curve.mean(b - 4 * STRIDE, b + 4 * STRIDE);
        k > 0 && w - m > self.tuning.wide * s * root(1.0 / f64::from(n) + 1.0 / f64::from(k))
    }

    fn walk(&mut self, curve: &Curve, here: i32, sigma: f64) -> Option<Next> {
        let t = self.tuning;
        let noisy = sigma > t.quiet;
        let frames = curve.at(Place(here)).map_or(0, |c| c.frames);
        if here != 0 && noisy && frames < t.per && self.budget(curve) > 0 {
            return Some(Next::Sample(Place(here)));
        }
        let (up, down) = (self.done(curve, 1, sigma), self.done(curve, -1, sigma));
        if up && down { return None; }
        if up { self.heading = -1; } else if down { self.heading = 1; } else {
            let reference = curve.reference();
            let s = sigma * reference.max(-reference);
            let z = curve.trend().significance(s) * f64::from(self.heading);
            if here.abs() == self.probe && curve.lowest().0.min(-curve.highest().0) == -self.probe && sigma > 0.0 && z.abs() < t.turn && u32::from(frames) < t.stay && self.budget(curve) > 0 {
                return Some(Next::Sample(Place(here)));
            }
            if z < -t.turn && here.abs() >= 2 * STRIDE && !self.fell(curve, -self.heading, sigma) { self.heading = -self.heading; self.turned = true; }
            else if !self.turned && t.turn_at > 0 && here.abs() == t.turn_at && z < t.turn { self.heading = -self.heading; self.turned = true; }
        }
        let seen = if self.heading > 0 { curve.highest().0 } else { curve.lowest().0 };
        Some(Next::Sample(Place(seen + self.heading * STRIDE)))
    }

    fn find(&self, curve: &Curve, sigma: f64) -> Option<peak::Peak> {
        let (b, _) = self.best?;
        let sigma = if sigma > self.tuning.quiet { sigma } else { 0.0 };
        peak::find(curve, (b - self.trap * 2).max(curve.lowest().0), (b + self.trap * 2).min(curve.highest().0), sigma, self.tuning.bias)
    }

    fn refine(&mut self, curve: &Curve, here: i32, sigma: f64, goal: i32, rounds: u8) -> Next {
        // Extra frames at every plausible place on the way.
        let way = (here - goal).abs() / STRIDE + 4;
        let share = (self.budget(curve) / (way + 1)).clamp(0, i32::from(self.tuning.extra)) as u16;
        let cell = curve.at(Place(here));
        let per = self.tuning.per;
        let v = smooth(curve, here).unwrap_or(0.0);
        let s = sigma * v.max(-v);
        let top = self.best.map_or(v, |b| b.1);
        let frames = cell.map_or(0, |c| c.frames);
        if v > top - self.tuning.plaus * s && frames < per + share.max(0) && self.budget(curve) > 0 && frames < per + self.tuning.extra {
            return Next::Sample(Place(here));
        }
        if here == goal {
            let Some(peak) = self.find(curve, sigma) else { return Next::Enough };
            let at = (if peak.at < 0.0 { peak.at - 0.5 } else { peak.at + 0.5 }) as i32;
            if rounds == 0 || (at - here).abs() <= STRIDE || self.budget(curve) < 10 { return Next::Enough; }
            self.stage = Stage::Refine { goal: at, rounds: rounds - 1 };
            return Next::Sample(Place(here + (at - here).signum()));
        }
        Next::Sample(Place(here + (goal - here).signum()))
    }
}

impl Search for Climb {
    fn next(&mut self, curve: &Curve, here: Place) -> Next {
        let t = self.tuning;
        let here = here.0;
        self.travelled += (here - self.last).abs();
        self.last = here;
        let sigma = curve.noise().relative();
        if curve.frames() < 3 || (sigma > 0.0 && curve.frames() < t.sense) {
            return Next::Sample(Place(0));
        }
        self.take_in(curve, here, sigma);
        if self.heading == 0 { self.heading = if curve.last().0 >= -curve.first().0 { 1 } else { -1 }; }
        match self.stage {
            Stage::Walk => {
                if here == curve.highest().0 { self.ends[1] = self.end(curve, here, -1, sigma); }
                if here == curve.lowest().0 { self.ends[0] = self.end(curve, here, 1, sigma); }
                if let Some(next) = self.walk(curve, here, sigma) { return next; }
                if sigma <= t.quiet { return Next::Enough; }
                let Some(peak) = self.find(curve, sigma) else { return Next::Enough };
                let goal = (if peak.at < 0.0 { peak.at - 0.5 } else { peak.at + 0.5 }) as i32;
                self.stage = Stage::Refine { goal, rounds: 4 };
                self.refine(curve, here, sigma, goal, 4)
            }
            Stage::Refine { goal, rounds } => self.refine(curve, here, sigma, goal, rounds),
        }
    }
}
