//! Where the peak is, from the samples around it.

use super::curve::{Curve, Place, STRIDE};
use super::noise::root;

/// Half-widths of the windows, in places, that are tried one after the other.
const WINDOWS: [i32; 12] = [2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 88];

/// A peak by its fit.
#[derive(Clone, Copy, Debug)]
pub struct Peak {
    /// Where, in places.
    pub at: f64,
    /// How high.
    pub value: f64,
    /// Standard error of the height.
    pub error: f64,
    /// Half-width of the window that was fitted.
    pub window: i32,
}

/// Finds the peak between two places. `sigma`: relative deviation of one frame.
pub fn find(curve: &Curve, from: i32, to: i32, sigma: f64, bias: f64) -> Option<Peak> {
    let mut best: Option<(Peak, f64)> = None;
    if sigma == 0.0 {
        return (from..=to).filter_map(|p| top(curve, p)).reduce(|a, b| if b.value > a.value { b } else { a });
    }
    for p in from..=to {
        let Some(v) = smooth(curve, p) else { continue };
        let higher = |q: i32| smooth(curve, q).is_some_and(|w| w > v);
        if (1..=2 * STRIDE).any(|d| higher(p - d) || higher(p + d)) {
            continue;
        }
        if let Some(peak) = fit(curve, p, sigma) {
            let score = peak.value - bias * peak.error;
            if best.is_none_or(|(_, s)| score > s) {
                best = Some((peak, score));
            }
        }
    }
    best.map(|b| b.0)
}

/// Mean of a place and its neighbours a step away, weighted 1 : 2 : 1.
pub fn smooth(curve: &Curve, p: i32) -> Option<f64> {
    let middle = curve.at(Place(p))?.mean;
    let side = |q: i32| curve.at(Place(q)).map_or(middle, |c| c.mean);
    Some(0.25 * (side(p - STRIDE) + 2.0 * middle + side(p + STRIDE)))
}

/// The nearest known place on one side.
fn beside(curve: &Curve, p: i32, side: i32) -> Option<(f64, f64)> {
    (1..=STRIDE).find_map(|d| curve.at(Place(p + d * side))).map(|c| (f64::from(c.place.0 - p), c.mean))
}

/// The parabola's top at a place whose neighbours are lower; its error is what a narrow peak may hide between samples.
pub fn top(curve: &Curve, p: i32) -> Option<Peak> {
    let middle = curve.at(Place(p))?.mean;
    let (l, r) = (beside(curve, p, -1)?, beside(curve, p, 1)?);
    if l.1 > middle || r.1 > middle {
        return None;
    }
    let drop = (middle - l.1) + (middle - r.1);
    Some(Peak { error: 0.15 * drop, ..exact(curve, p, middle) })
}

fn exact(curve: &Curve, p: i32, value: f64) -> Peak {
    let mut peak = Peak { at: f64::from(p), value, error: 0.0, window: 1 };
    if let (Some((xl, l)), Some((xr, r))) = (beside(curve, p, -1), beside(curve, p, 1)) {
        // The parabola through three points, by divided differences from the middle one.
        let (sl, sr) = ((l - value) / xl, (r - value) / xr);
        let bend = (sr - sl) / (xr - xl);
        if bend < 0.0 {
            let slope = sl - bend * xl;
            let shift = -slope / (2.0 * bend);
            if shift >= xl && shift <= xr {
                peak.at += shift;
                peak.value += 0.5 * slope * shift;
            }
        }
    }
    peak
}

/// Widens the window while one smooth peak still explains what it holds.
fn fit(curve: &Curve, p: i32, sigma: f64) -> Option<Peak> {
    let narrow = exact(curve, p, curve.at(Place(p))?.mean);
    let mut best = Peak { error: sigma * narrow.value.max(-narrow.value) / root(f64::from(curve.at(Place(p))?.frames)), ..narrow };
    let mut bend = 0.0;
    for h in WINDOWS {
        let c = round(best.at);
        if curve.lowest().0 > c - h || curve.highest().0 < c + h {
            break;
        }
        let Some(mut f) = solve(curve, c, h, best.at, bend, sigma) else { continue };
        if f.freedom > 0.0 && f.misfit > f.freedom + CHI * root(2.0 * f.freedom) {
            break;
        }
        let limit = REACH * f64::from(h);
        if !(f.bend > 0.0) || f.shift.abs() > limit {
            continue;
        }
        let mut at = best.at + f.shift;
        if let Some(again) = solve(curve, c, h, at, f.bend, sigma).filter(|a| a.bend > 0.0 && a.shift.abs() < limit) {
            f = again;
            at += f.shift;
        }
        bend = f.bend;
        best = Peak { at, value: f.top, error: f.error, window: h };
    }
    Some(best)
}

fn round(x: f64) -> i32 {
    (if x < 0.0 { x - 0.5 } else { x + 0.5 }) as i32
}

struct Fit { top: f64, shift: f64, bend: f64, misfit: f64, freedom: f64, error: f64 }

const CHI: f64 = 2.5;
const REACH: f64 = 0.5;
/// How much the two sides' curvatures differ, relative to their mean: a prior.
const LOPSIDED: f64 = 0.2;

/// Least squares of a + b·x − k·x² + d·x|x| + e·x⁴ around `v`, d held near 0 by the prior.
fn solve(curve: &Curve, c: i32, h: i32, v: f64, bend: f64, sigma: f64) -> Option<Fit> {
    const N: usize = 5;
    let unit = f64::from(h);
    let reference = curve.at(Place(c)).or_else(|| curve.at(Place(c + 1))).or_else(|| curve.at(Place(c - 1)))?.mean;
    let s = sigma * reference.max(-reference);
    let terms = if h < 4 { 3 } else if h < 6 { 4 } else { N };
    let mut m = [[0.0f64; N + 1]; N];
    let (mut yy, mut n) = (0.0, 0.0);
    for cell in (c - h..=c + h).filter_map(|p| curve.at(Place(p))) {
        let w = f64::from(cell.frames);
        let x = (f64::from(cell.place.0) - v) / unit;
        let y = (cell.mean - reference) / s;
        let f = [1.0, x, x * x, x * x.max(-x), x * x * x * x];
        for i in 0..terms {
            for j in i..terms { m[i][j] += w * f[i] * f[j]; }
            m[i][N] += w * f[i] * y;
        }
        yy += w * y * y;
        n += 1.0;
    }
    for i in 0..terms { for j in 0..i { m[i][j] = m[j][i]; } }
    if terms > 3 {
        // The prior is one more measurement: d = 0 ± LOPSIDED·k.
        let k = LOPSIDED * if bend > 0.0 { bend * unit * unit / s } else { 1.0 };
        m[3][3] += 1.0 / (k * k);
    }
    let rhs: [f64; N] = core::array::from_fn(|i| m[i][N]);
    // Gauss, then the first diagonal element of the inverse by a second right-hand side.
    let mut g = [[0.0f64; N + 2]; N];
    for i in 0..terms { for j in 0..terms { g[i][j] = m[i][j]; } g[i][N] = rhs[i]; g[i][N + 1] = if i == 0 { 1.0 } else { 0.0 }; }
    for i in 0..terms {
        if g[i][i] <= 1e-12 { return None; }
        for r in 0..terms {
            if r == i { continue; }
            let q = g[r][i] / g[i][i];
            for j in 0..N + 2 { g[r][j] -= q * g[i][j]; }
        }
    }
    let x: [f64; N] = core::array::from_fn(|i| if i < terms { g[i][N] / g[i][i] } else { 0.0 });
    let mut misfit = yy;
    for i in 0..terms { misfit -= x[i] * rhs[i]; }
    let bend = -x[2];
    let shift = if bend > 0.0 { 0.5 * x[1] / bend * unit } else { 0.0 };
    Some(Fit {
        top: reference + s * (x[0] + if bend > 0.0 { 0.25 * x[1] * x[1] / bend } else { 0.0 }),
        shift, bend: bend * s / (unit * unit), misfit, freedom: n - terms as f64 + if terms > 3 { 0.8 } else { 0.0 } - 1.0,
        error: s * root(g[0][N + 1] / g[0][0]),
    })
}
