//! Where the peak is, between the samples.
//!
//! Without noise the parabola through the highest sample and its neighbours is all there is to know. With noise each
//! local maximum is fitted in windows that widen for as long as one smooth peak explains what they hold (χ², after
//! Lepski 1991: the widest window that the data do not contradict has the least error). A narrow bump keeps its
//! narrow window, a broad top gets a wide one; the highest lower confidence bound wins.

use super::curve::{Cell, Curve, Place, STRIDE, Side, magnitude};
use super::exact::{doubled, halved, product, quotient};
use super::fit::{self, Model};
use super::noise::root;
use super::tops::Top;
use heapless::Vec;

/// Half-widths of the windows, in places.
const WINDOWS: [i32; 12] = [2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 88];

/// Standard errors taken off a peak's height, because the highest of many was picked.
const CAUTION: f64 = 3.0;

/// Standard deviations of one frame below the best at which a maximum is not worth a fit.
const HOPELESS: f64 = 3.0;

/// What of the curve's height the smoothing may take off a narrow top.
const SMOOTHED: f64 = 0.1;

/// Standard deviations of χ² above its mean at which a window is contradicted.
const MISFIT: f64 = 2.5;

/// What of the drop to its neighbours a peak may hide above the parabola through them, if it lies halfway between two
/// samples: a Gaussian whose standard deviation is one sample step hides 0.086.
const HIDDEN: f64 = 0.1;

/// The same above the polynomial through five samples half a step apart.
const HIDDEN_FROM_FIVE: f64 = 0.025;

/// How far a sweep's samples may lie apart, in places.
const APART: i32 = 64;

/// Tops that are kept while the highest is looked for.
const TOPS: usize = 16;

/// A local maximum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Where, in places.
    pub at: f64,
    /// How high.
    pub value: f64,
    /// Standard error of the height, or what may be hidden between samples.
    pub error: f64,
    /// Half-width of the window that the fit explains, in places.
    pub window: i32,
}

/// The highest peak between two places.
pub fn find(curve: &Curve, from: Place, to: Place) -> Option<Peak> {
    let places = (from.0..=to.0).map(Place);
    if curve.noise().is_silent() {
        return tops(curve, from, to).map(|(_, top)| top).reduce(|a, b| if b.value > a.value { b } else { a });
    }
    let (_, best) = curve.best()?;
    // A narrow top loses up to a fifth of itself to the smoothing, and more to lying between two samples.
    let least = best - HOPELESS * curve.noise().relative() * magnitude(best) - SMOOTHED * (best - curve.floor());
    let bound = |p: &Peak| p.value - CAUTION * p.error;
    places
        .filter(|p| curve.smooth(*p).is_some_and(|v| v > least) && is_local_maximum(curve, *p))
        .filter_map(|p| widen(curve, p))
        .reduce(|a, b| if bound(&b) > bound(&a) { b } else { a })
}

/// Every [`top`] between two places, with its place.
pub fn tops(curve: &Curve, from: Place, to: Place) -> impl Iterator<Item = (Place, Peak)> + '_ {
    let mut next = from.0;
    // Nothing is known beyond what was seen.
    let end = (to.0 + APART).min(curve.seen(Side::High).0);
    // The known place before: its value, and whether that is not lower than the one before it.
    let mut last: Option<(i32, f64, bool)> = None;
    let summits = core::iter::from_fn(move || {
        loop {
            if last.is_some_and(|l| l.0 > to.0) || next > end {
                return None;
            }
            let here = next;
            next += 1;
            // Values are compared without software floats: most places are no top.
            let Some(value) = curve.mean(Place(here)) else { continue };
            let rose = match last {
                Some((_, before, _)) => value.total_cmp(&before).is_ge(),
                None => value_beside(curve, Place(here), -1).is_some_and(|v| v.total_cmp(&value).is_le()),
            };
            let summit = last.filter(|(_, before, rose)| *rose && value.total_cmp(before).is_le());
            last = Some((here, value, rose));
            if let Some((place, ..)) = summit {
                return Some(Place(place));
            }
        }
    });
    summits.filter_map(|p| Some((p, top(curve, p)?)))
}

fn is_local_maximum(curve: &Curve, place: Place) -> bool {
    let Some(value) = curve.smooth(place) else { return false };
    let higher = |p: i32| curve.smooth(Place(p)).is_some_and(|v| v > value);
    !(1..=2 * STRIDE).any(|d| higher(place.0 - d) || higher(place.0 + d))
}

/// Whether a place's neighbours are known and not higher, compared without software floats.
pub fn is_top(curve: &Curve, place: Place) -> bool {
    let Some(value) = curve.mean(place) else { return false };
    [-1, 1].iter().all(|sign| value_beside(curve, place, *sign).is_some_and(|v| v.total_cmp(&value).is_le()))
}

/// The parabola's top at a place whose neighbours are not higher.
pub fn top(curve: &Curve, place: Place) -> Option<Peak> {
    let kept = curve.tops().at(place);
    kept.or_else(|| if is_top(curve, place) { work_out(curve, place).map(|top| top.peak) } else { None })
}

/// The same for a place that [`is_top`].
pub fn work_out(curve: &Curve, place: Place) -> Option<Top> {
    let middle = curve.at(place)?;
    let (mut from, mut to) = (near(curve, place, -1)?, near(curve, place, 1)?);
    let (low, high) = (curve.at(from)?, curve.at(to)?);
    let drop = (middle.mean - low.mean) + (middle.mean - high.mean);
    let width = high.past(low);
    let halves = width <= f64::from(STRIDE);
    let (mut peak, mut hidden) = (parabola(middle, low, high), HIDDEN);
    if halves || width > 4.0 * f64::from(STRIDE) {
        let outer = beyond(curve, low, high);
        (from, to) = match outer {
            Some((l, h)) => (l.place, h.place),
            None => (Place(from.0 - APART), Place(to.0 + APART)),
        };
        let outer = outer.filter(|(l, h)| !halves || h.past(*l) <= 2.0 * f64::from(STRIDE));
        if let Some(better) = outer.and_then(|(l, h)| quartic([l, low, middle, high, h], peak.at)) {
            if !halves {
                return Some(Top { place, from, to, peak: better });
            }
            (peak, hidden) = (better, HIDDEN_FROM_FIVE);
        }
    }
    let halfway = quotient(product(peak.at - middle.x, 4.0), width);
    // Half the distance hides a quarter of a drop that is a quarter, too.
    let apart = quotient(width, 2.0 * f64::from(STRIDE));
    peak.error = product(product(hidden * drop * halfway * halfway, apart), apart);
    Some(Top { place, from, to, peak })
}

/// The tops between two places that may be the highest, each with its place, by what is known of them.
pub fn rivals(curve: &Curve, from: Place, to: Place) -> impl Iterator<Item = (Place, Peak)> + '_ {
    // Few tops are kept from the search for the highest one. Were there more, they are found again.
    let mut kept: Vec<(Place, Peak), TOPS> = Vec::new();
    let mut fits = true;
    let noted = tops(curve, from, to).inspect(|top| fits &= kept.push(*top).is_ok());
    let highest = noted.map(|(_, t)| t).reduce(|a, b| if b.value > a.value { b } else { a });
    let least = highest.map_or(0.0, |h| h.value - h.error);
    let noise = 3.0 * curve.noise().relative() * magnitude(least);
    let again = (!fits).then(|| tops(curve, from, to)).into_iter().flatten();
    let kept = if fits { kept } else { Vec::new() };
    kept.into_iter().chain(again).filter(move |(_, t)| t.value + t.error + noise >= least)
}

/// The nearest known place on one side.
pub fn near(curve: &Curve, place: Place, sign: i32) -> Option<Place> {
    // Nothing is known beyond what was seen.
    let side = if sign < 0 { Side::Low } else { Side::High };
    let reach = ((curve.seen(side).0 - place.0) * sign).min(APART);
    (1..=reach).map(|d| Place(place.0 + d * sign)).find(|p| curve.mean(*p).is_some())
}

/// What is known of [`near`].
fn beside(curve: &Curve, place: Place, sign: i32) -> Option<Cell> {
    near(curve, place, sign).and_then(|p| curve.at(p))
}

/// The value of [`beside`].
fn value_beside(curve: &Curve, place: Place, sign: i32) -> Option<f64> {
    near(curve, place, sign).and_then(|p| curve.mean(p))
}

/// The extremum of the parabola through three cells; the middle one where it has none between the others.
pub fn parabola(middle: Cell, low: Cell, high: Cell) -> Peak {
    let mut peak = Peak { at: middle.x, value: middle.mean, error: 0.0, window: 1 };
    // Divided differences from the middle.
    let (xl, xh) = (low.past(middle), high.past(middle));
    let (sl, sh) = (quotient(low.mean - middle.mean, xl), quotient(high.mean - middle.mean, xh));
    let bend = quotient(sh - sl, xh - xl);
    let slope = sl - product(bend, xl);
    let shift = -slope / doubled(bend);
    if shift >= xl && shift <= xh {
        peak.at += shift;
        peak.value += halved(slope) * shift;
    }
    peak
}

/// The cells next to two cells, outwards.
fn beyond(curve: &Curve, low: Cell, high: Cell) -> Option<(Cell, Cell)> {
    let next = |near: Cell, sign: i32| {
        let cells = (1..=APART).filter_map(|d| curve.at(Place(near.place.0 + d * sign)));
        { cells }.find(|c| if sign < 0 { c.x < near.x } else { c.x > near.x })
    };
    Some((next(low, -1)?, next(high, 1)?))
}

/// The top of the polynomial through five cells that lie far apart, as in a sweep: a parabola through three would be
/// off by a fiftieth of their distance. By Newton's divided differences, and his steps from that parabola's top, `at`.
fn quartic(cells: [Cell; 5], mut at: f64) -> Option<Peak> {
    let mut c = cells.map(|cell| cell.mean);
    for order in 1..5 {
        for i in (order..5).rev() {
            c[i] = quotient(c[i] - c[i - 1], cells[i].past(cells[i - order]));
        }
    }
    // The value is that before the last step; only there it is worked out.
    let (mut p, mut x) = (0.0, 0.0);
    for _ in 0..4 {
        // The first steps of the scheme without what multiplies zero.
        p = c[4] * (at - cells[3].x) + c[3];
        x = at - cells[2].x;
        let (mut slope, mut bend) = (c[4] * x + p, doubled(c[4]));
        p = p * x + c[2];
        x = at - cells[1].x;
        bend = bend * x + doubled(slope);
        slope = slope * x + p;
        p = p * x + c[1];
        x = at - cells[0].x;
        bend = bend * x + doubled(slope);
        slope = slope * x + p;
        let before = at;
        if bend < 0.0 {
            at -= slope / bend;
        }
        if at.to_bits() == before.to_bits() {
            break;
        }
    }
    let value = p * x + c[0];
    let inside = at > cells[1].x && at < cells[3].x && value >= cells[2].mean;
    inside.then_some(Peak { at, value, error: 0.0, window: 2 })
}

/// The widest window around a local maximum that one smooth peak explains.
fn widen(curve: &Curve, place: Place) -> Option<Peak> {
    let cell = curve.at(place)?;
    let sigma = curve.noise().relative() * magnitude(cell.mean);
    let mut best = match (beside(curve, place, -1), beside(curve, place, 1)) {
        (Some(low), Some(high)) => parabola(cell, low, high),
        _ => Peak { at: cell.x, value: cell.mean, error: 0.0, window: 1 },
    };
    best.error = sigma / root(f64::from(cell.frames));
    let mut bend = None;
    for half in WINDOWS {
        let middle = Place((if best.at < 0.0 { best.at - 0.5 } else { best.at + 0.5 }) as i32);
        let (from, to) = (Place(middle.0 - half), Place(middle.0 + half));
        if curve.seen(Side::Low) > from || curve.seen(Side::High) < to {
            break;
        }
        let model = Model { from, to, sigma, bend };
        let Some(mut fit) = fit::smooth_peak(curve, &model, best.at) else { continue };
        if fit.freedom > 0.0 && fit.misfit > fit.freedom + MISFIT * root(2.0 * fit.freedom) {
            break;
        }
        let usable = |f: &fit::Fit| f.bend > 0.0 && magnitude(f.shift) < 0.5 * f64::from(half);
        if !usable(&fit) {
            // Too narrow to see the bend through the noise: a wider one may.
            continue;
        }
        let mut at = best.at + fit.shift;
        let again = Model { bend: Some(fit.bend), ..model };
        if let Some(better) = fit::smooth_peak(curve, &again, at).filter(usable) {
            fit = better;
            at += fit.shift;
        }
        bend = Some(fit.bend);
        if fit.error > best.error && best.error > 0.0 {
            // Few frames far apart, as in a sweep: more terms than they can carry.
            continue;
        }
        best = Peak { at, value: fit.top, error: fit.error, window: half };
    }
    Some(best)
}
