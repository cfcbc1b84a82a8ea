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
        let top = (from..=to).filter_map(|p| curve.at(Place(p))).reduce(|a, b| if b.mean > a.mean { b } else { a })?;
        return Some(exact(curve, top.place.0, top.mean));
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

/// Widens the window while a peak with a curvature of its own on each side still explains what it holds.
fn fit(curve: &Curve, p: i32, sigma: f64) -> Option<Peak> {
    let mut at = f64::from(p);
    let mut best: Option<Peak> = None;
    if let Some(c) = curve.at(Place(p)) {
        let narrow = exact(curve, p, c.mean);
        at = narrow.at;
        best = Some(Peak { error: sigma * c.mean.max(-c.mean) / root(f64::from(c.frames)), ..narrow });
    }
    for h in WINDOWS {
        let c = round(at);
        if curve.lowest().0 > c - h || curve.highest().0 < c + h {
            if best.is_some() { break; }
        }
        let reach = (f64::from(h) * 0.5).min(8.0);
        let steps = 8;
        let mut least: Option<(f64, [f64; 3], f64, f64, f64)> = None;
        for i in -steps..=steps {
            let v = at + reach * f64::from(i) / f64::from(steps);
            let Some((rss, k, n, e)) = solve(curve, c - h, c + h, v, sigma) else { continue };
            if least.is_none_or(|l| rss < l.0) {
                least = Some((rss, k, v, n, e));
            }
        }
        let Some((rss, k, v, n, e)) = least else { break };
        let freedom = n - 4.0;
        if freedom > 0.0 && rss > freedom + 2.5 * root(2.0 * freedom) && best.is_some() {
            break;
        }
        // Not a maximum: nothing to gain from this window.
        if k[1] <= 0.0 && k[2] <= 0.0 { if best.is_some() { break; } else { continue; } }
        at = v;
        best = Some(Peak { at: v, value: k[0], error: e, window: h });
    }
    best
}

fn round(x: f64) -> i32 {
    (if x < 0.0 { x - 0.5 } else { x + 0.5 }) as i32
}

/// Least squares of `a − l·(x−v)²₋ − r·(x−v)²₊`: χ², (a, l, r), places used, standard error of a.
fn solve(curve: &Curve, from: i32, to: i32, v: f64, sigma: f64) -> Option<(f64, [f64; 3], f64, f64)> {
    let (mut s0, mut sl, mut sr, mut sll, mut srr) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let (mut y0, mut yl, mut yr, mut yy, mut n) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let p = round(v);
    let reference = curve.at(Place(p)).or_else(|| curve.at(Place(p + 1))).or_else(|| curve.at(Place(p - 1)))?.mean;
    for cell in (from..=to).filter_map(|p| curve.at(Place(p))) {
        let w = f64::from(cell.frames);
        let x = f64::from(cell.place.0) - v;
        let y = cell.mean - reference;
        let q = x * x;
        s0 += w; y0 += w * y; yy += w * y * y; n += 1.0;
        if x < 0.0 { sl += w * q; sll += w * q * q; yl += w * q * y; } else { sr += w * q; srr += w * q * q; yr += w * q * y; }
    }
    if sll <= 0.0 || srr <= 0.0 { return None; }
    // Eliminate l and r.
    let d = s0 - sl * sl / sll - sr * sr / srr;
    if d <= 1e-9 * s0 { return None; }
    let a = (y0 - sl * yl / sll - sr * yr / srr) / d;
    let l = -(yl - a * sl) / sll;
    let r = -(yr - a * sr) / srr;
    let rss = yy - a * y0 + l * yl + r * yr;
    let s = sigma * if reference < 0.0 { -reference } else { reference };
    Some((rss / (s * s), [a + reference, l, r], n, s / root(d)))
}
