//! Where the peak is, between the samples.
//!
//! Without noise the parabola through the highest sample and its neighbours is all there is to know, or where they lie close
//! or far apart the polynomial through five. With noise there is [`super::finding`].

use super::curve::{Cell, Curve, Place, STRIDE, Side};
use super::exact::{doubled, halved, product, quotient};
use super::tops::Top;

/// What of the drop to its neighbours a peak may hide above the parabola through them, if it lies halfway between two
/// samples: a Gaussian whose standard deviation is one sample step hides 0.086.
const HIDDEN: f64 = 0.1;

/// The same above the polynomial through five samples half a step apart.
const HIDDEN_FROM_FIVE: f64 = 0.025;

/// How far a sweep's samples may lie apart, in places.
pub const APART: i32 = 64;

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

/// The nearest known place on one side.
pub fn near(curve: &Curve, place: Place, sign: i32) -> Option<Place> {
    // Nothing is known beyond what was seen.
    let side = if sign < 0 { Side::Low } else { Side::High };
    let reach = ((curve.seen(side).0 - place.0) * sign).min(APART);
    (1..=reach).map(|d| Place(place.0 + d * sign)).find(|p| curve.mean(*p).is_some())
}

/// What is known of [`near`].
pub fn beside(curve: &Curve, place: Place, sign: i32) -> Option<Cell> {
    near(curve, place, sign).and_then(|p| curve.at(p))
}

/// The value of [`beside`].
pub fn value_beside(curve: &Curve, place: Place, sign: i32) -> Option<f64> {
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
