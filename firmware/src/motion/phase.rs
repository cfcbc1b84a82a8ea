//! A stretch of one axis' motion over which its steps follow one cubic in time, or come evenly.

use super::fixed::{divide, fixed, mul_high, power, single, unfixed};
use super::swing::Quarter;

/// A stretch in one direction. Distances are steps along that direction, times are ticks from `begin`.
///
/// The edge of step `k` comes where the exact path passes `k − ½`: the counted position is the one nearest to the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phase {
    /// Tick of the timeline at which it begins.
    pub begin: u64,
    /// How long it takes.
    pub ticks: u64,
    /// Steps whose edges lie in it.
    pub steps: u32,
    /// Towards larger counts.
    pub up: bool,
    /// Time of the first edge, ticks · 2³².
    pub first: u64,
    /// How the path goes.
    pub shape: Shape,
}

/// The path within a phase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Constant speed.
    Even {
        /// Ticks · 2³² from edge to edge.
        interval: u64,
    },
    /// Constant jerk.
    Curved(Cubic),
    /// A cosine from its turning point, quarter after quarter; the first two go one way, the next two the other.
    Swing {
        /// Steps from the middle to a turning point, at most [`AMPLITUDE`](super::swing::AMPLITUDE).
        amplitude: u32,
        /// Ticks · 2³² of a quarter.
        quarter: u64,
    },
}

/// Distance as a cubic in y = time / 2^shift: c₁y + c₂y² + c₃y³, coefficients in steps · 2³². `reversed` counts distance and
/// time backwards from the phase's end, so that a phase that comes to rest keeps its precision where it is slow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cubic {
    /// Ticks of the whole phase, less than 2^shift.
    pub ticks: u32,
    /// At most 31.
    pub shift: u32,
    /// Whether distance and time are counted from the end.
    pub reversed: bool,
    /// Distance of the edge nearest to where distance is counted from, steps · 2³².
    pub near: i64,
    /// c₁, c₂, c₃.
    pub c: [i64; 3],
    /// The same in single precision, in steps.
    pub f: [f32; 3],
}

/// An instant within a cubic phase, for the step to the next.
#[derive(Clone, Copy, Debug)]
pub struct Slope {
    /// dy per step.
    m: f32,
    /// d²s/dy².
    a: f32,
    /// d³s/dy³.
    j: f32,
}

impl Cubic {
    /// y · 2⁶⁴ at a time of ticks · 2³².
    #[inline(always)]
    fn y(&self, time: u64) -> u64 {
        let from = if self.reversed { (u64::from(self.ticks) << 32).saturating_sub(time) } else { time };
        from << (32 - self.shift)
    }

    /// Distance at y · 2⁶⁴.
    #[inline(always)]
    fn distance(&self, y: u64) -> i64 {
        let [c1, c2, c3] = self.c;
        mul_high(mul_high(mul_high(c3, y) + c2, y) + c1, y)
    }

    #[inline(always)]
    fn slope(&self, y: u64) -> Slope {
        let [f1, f2, f3] = self.f;
        let y = ((y >> 32) as u32) as f32 * power(-32);
        let v = f1 + y * (2.0 * f2 + 3.0 * f3 * y);
        // At rest a step takes for ever.
        let v = if v > 1e-30 { v } else { 1e-30 };
        Slope { m: 1.0 / v, a: 2.0 * f2 + 6.0 * f3 * y, j: 6.0 * f3 }
    }

    /// Distance of the edge `index` of `steps`.
    #[inline(always)]
    fn target(&self, index: u32, steps: u32) -> i64 {
        let from = if self.reversed { steps.wrapping_sub(1).wrapping_sub(index) } else { index };
        self.near + ((from as i64) << 32)
    }

    /// Time of an edge, by Newton's method from `guess`, and the slope there.
    fn solve(&self, index: u32, steps: u32, guess: u64) -> (u64, Slope) {
        let target = self.target(index, steps);
        let end = u64::from(self.ticks) << 32;
        let mut time = guess.min(end);
        let scale = power(self.shift as i32);
        // Near rest each round takes a third off the error; elsewhere one or two do.
        for _ in 0..24 {
            let y = self.y(time);
            let slope = self.slope(y);
            let off = single(target - self.distance(y)) * slope.m;
            let ticks = off * scale * power(-32);
            let change = fixed(ticks);
            time = time.saturating_add_signed(if self.reversed { -change } else { change }).min(end);
            // What Newton leaves of an error d is d² · (s″ + d · s‴) / 2s′ at most about.
            let d = ticks * power(-(self.shift as i32));
            let left = d * ticks * slope.m * (slope.a.abs() + (slope.j * d).abs());
            if left.abs() < 0.02 && ticks.abs() < 4096.0 {
                break;
            }
        }
        let y = self.y(time);
        (time, self.slope(y))
    }
}

/// Largest exponent of a span's length.
const LONGEST_SPAN: u32 = 8;

/// Edges, most often up to 2⁸, whose times are one cubic in their index, by forward differences. Times are ticks · 2³² from `begin`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Span {
    /// Edges left.
    pub left: u32,
    /// Time of the next, with the timeline's tick (modulo 2³²) in the upper half, rounded by the half tick already in it.
    pub time: u64,
    /// Its differences.
    pub by: [i64; 3],
    /// Towards larger counts.
    pub up: bool,
}

/// Where the generator stands in a phase: the next edge, and its exact time.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Index of the edge within the phase.
    pub index: u32,
    /// Its time, ticks · 2³² from `begin`.
    pub time: u64,
    /// Tick that `time` counts from.
    pub begin: u64,
    slope: Option<Slope>,
}

impl Phase {
    /// Leaves the first `steps` edges.
    pub fn cut(&mut self, steps: u32) {
        if let Shape::Curved(cubic) = &mut self.shape
            && cubic.reversed
        {
            cubic.near += (self.steps.saturating_sub(steps) as i64) << 32;
        }
        self.steps = self.steps.min(steps);
    }

    /// Before its first edge.
    pub fn place(&self) -> Place {
        Place { index: 0, time: self.first, begin: self.begin, slope: None }
    }

    /// At an edge, given roughly its tick.
    pub fn seek(&self, index: u32, tick: u64) -> Place {
        match &self.shape {
            Shape::Even { interval } => {
                let past = u128::from(*interval) * u128::from(index) + u128::from(self.first);
                Place { index, time: past as u32 as u64, begin: self.begin + (past >> 32) as u64, slope: None }
            }
            Shape::Curved(cubic) => {
                let guess = tick.saturating_sub(self.begin).min(u64::from(cubic.ticks)) << 32;
                let (time, slope) = cubic.solve(index, self.steps, guess);
                Place { index, time, begin: self.begin, slope: Some(slope) }
            }
            Shape::Swing { amplitude, quarter } => {
                let past = u128::from(*quarter) * u128::from(index.saturating_sub(1) / (*amplitude).max(1));
                Place { index, time: past as u32 as u64, begin: self.begin + (past >> 32) as u64, slope: None }
            }
        }
    }

    /// The next edges, and the place after them. There must be at least one left.
    pub fn span(&self, place: &mut Place, table: &Quarter) -> Span {
        let left = self.steps.saturating_sub(place.index);
        match &self.shape {
            Shape::Even { interval } => {
                // A cruise may outlast 2³² ticks: keep the time small.
                place.begin += place.time >> 32;
                place.time &= 0xffff_ffff;
                let n = left
                    .min(1 << 16)
                    .min((u64::from(u32::MAX) << 31).checked_div(*interval).unwrap_or(1) as u32)
                    .max(1);
                let span = Span { left: n, time: stamp(place), by: [*interval as i64, 0, 0], up: self.up };
                place.index = place.index.wrapping_add(n);
                place.time = place.time.wrapping_add(interval.wrapping_mul(u64::from(n)));
                span
            }
            Shape::Swing { amplitude, quarter } => swing(*amplitude, *quarter, self.up, place, table),
            Shape::Curved(cubic) => curved(cubic, self.steps, left, self.up, place),
        }
    }
}

/// One edge of a swing. `place.time` is where the quarter of the edge before begins.
fn swing(amplitude: u32, quarter: u64, up: bool, place: &mut Place, table: &Quarter) -> Span {
    let (quarters, edge) = (place.index / amplitude.max(1), place.index % amplitude.max(1));
    if edge == 0 && place.index > 0 {
        place.time += quarter;
        place.begin += place.time >> 32;
        place.time &= 0xffff_ffff;
    }
    let from_turn = |edge: u32| table.get(edge as usize).map_or(0, |t| u64::from(*t) << 28);
    let time = if quarters.is_multiple_of(2) {
        from_turn(edge)
    } else {
        quarter.saturating_sub(from_turn(amplitude.wrapping_sub(1).wrapping_sub(edge)))
    };
    place.index = place.index.wrapping_add(1);
    Span { left: 1, time: stamp(place).wrapping_add(time), by: [0; 3], up: up ^ (quarters / 2 % 2 == 1) }
}

/// The tick of the timeline, modulo 2³², and its fraction plus a half.
#[inline(always)]
fn stamp(place: &Place) -> u64 {
    (place.begin << 32).wrapping_add(place.time).wrapping_add(1 << 31)
}

fn curved(cubic: &Cubic, steps: u32, left: u32, up: bool, place: &mut Place) -> Span {
    if left < 2 {
        let span = Span { left: 1, time: stamp(place), by: [0; 3], up };
        place.index = place.index.wrapping_add(1);
        return span;
    }
    let scale = power(cubic.shift as i32);
    let here = place.slope.unwrap_or_else(|| cubic.slope(cubic.y(place.time)));
    let sign = if cubic.reversed { -1.0 } else { 1.0 };
    let per_step = here.m * scale;
    // Speed changes by about α + β relative to itself in n steps; the fourth derivative of time by step, times n⁴ / 384, is the
    // largest error of a cubic through both ends with the slopes there (Hermite): 1/8 tick, 1/16 where a speed is falling.
    let (a1, b1) = ((here.a * here.m * here.m).abs(), (here.j * here.m * here.m * here.m).abs());
    let mut q = LONGEST_SPAN;
    while q > 0 {
        let n = (1u32 << q) as f32;
        let b = b1 * n * n;
        let a = a1 * n + b;
        let time = n * per_step;
        if a < 0.125 && time < 1_048_576.0 && time * a * (15.0 * a * a + 10.0 * b) < 24.0 {
            break;
        }
        q -= 1;
    }
    // The edge after the span must exist: it is solved for.
    let n = (1u32 << q).min(left - 1);
    let start = stamp(place);
    let steps_on = n as f32;
    let s = sign * steps_on;
    let a = here.a * s * here.m * here.m;
    let b = here.j * s * s * here.m * here.m * here.m;
    let dy = s * here.m * (1.0 - a * 0.5 + (3.0 * a * a - b) * (1.0 / 6.0));
    let ahead = (dy * scale * sign).max(0.0);
    let guess = place.time.saturating_add(fixed(ahead) as u64);
    let (time, there) = cubic.solve(place.index.wrapping_add(n), steps, guess);
    let time = time.max(place.time);
    let mean = divide(time - place.time, n);
    let span = if n == 1 {
        Span { left: 1, time: start, by: [mean as i64, 0, 0], up }
    } else {
        let mean_ticks = unfixed(mean);
        let (e0, e1) = (per_step - mean_ticks, there.m * scale - mean_ticks);
        let part = 1.0 / steps_on;
        let c = fixed(-(2.0 * e0 + e1) * part);
        let d = fixed((e0 + e1) * part * part);
        Span { left: n, time: start, by: [mean as i64 + fixed(e0) + c + d, 2 * c + 6 * d, 6 * d], up }
    };
    *place = Place { index: place.index.wrapping_add(n), time, begin: place.begin, slope: Some(there) };
    span
}
