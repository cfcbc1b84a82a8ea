//! What came of it: a peak, the focus of a phase object, or the reason why the curve makes no sense.

use super::climb::fell;
use super::curve::{Cell, Curve, Place, STRIDE, Side, magnitude};
use super::noise::root;
use super::peak::{self, Peak};
use super::refine::Refine;
use parfocal_protocol::autofocus::{ScanRefusal, Subject};

/// Φ must fall by this share of the curve's height towards an end of the range.
const EDGE_FALL: f64 = 0.05;

/// Standard errors that a fall must be worth, where it decides.
const SURE: f64 = 4.0;

/// Two peaks are alike when the lower one has this share of the higher one's height.
const ALIKE: f32 = 0.9;

/// Two peaks are apart when the curve between them falls below this share of the height,
const APART: f32 = 0.75;

/// and when they are further apart than this many trap radii.
const FAR: f32 = 1.5;

/// Light drifts when places visited again have changed by this share of the curve's height.
const DRIFT: f64 = 0.05;

/// Judges a finished search; `trap` in places. The answer is where the focus is, in places, and how high the peak.
///
/// # Errors
/// The reason why the curve has no focus that can be trusted.
pub fn judge(curve: &Curve, trap: i32, subject: Subject, sweeping: bool) -> Result<Peak, ScanRefusal> {
    let Some((from, to)) = Refine::window(curve, trap) else { return Err(ScanRefusal::SamplesStopped) };
    let best = curve.best().map_or(0.0, |(_, v)| v);
    if best <= curve.floor() && curve.noise().is_none() {
        return Err(ScanRefusal::NoContrast);
    }
    let values = (from.0..=to.0).filter_map(|p| Some((p, curve.mean(Place(p))?)));
    let highest = values.reduce(|a, b| if b.1.total_cmp(&a.1).is_gt() { b } else { a });
    let highest = highest.and_then(|(p, _)| curve.at(Place(p))).ok_or(ScanRefusal::SamplesStopped)?;
    let found = peak::find(curve, from, to);
    let peak = found.unwrap_or(Peak { at: highest.x, value: highest.mean, error: 0.0, window: 1 });
    let height = peak.value - curve.floor();
    let valley = valley(curve, trap, highest);
    if subject == Subject::PhaseObject {
        return valley.filter(|v| v.is_focus(peak.value)).map(|v| v.bottom).ok_or(ScanRefusal::NoSignificantPeak);
    }
    drifts(curve, height, peak.value, sweeping)?;
    at_edge(curve, &peak, height)?;
    if ![Side::Low, Side::High].iter().all(|s| fell(curve, *s)) {
        return Err(ScanRefusal::NoSignificantPeak);
    }
    if valley.is_some_and(|v| v.vanishes(peak.value, curve.floor())) {
        return Err(ScanRefusal::PhaseObject);
    }
    two_peaks(curve, trap, height)?;
    found.ok_or(ScanRefusal::NoSignificantPeak)
}

/// Refuses a peak at an end of the range, or one from which the curve does not fall towards an end that was reached.
fn at_edge(curve: &Curve, peak: &Peak, height: f64) -> Result<(), ScanRefusal> {
    let sigma = curve.noise().relative() * magnitude(peak.value);
    for side in [Side::Low, Side::High] {
        let limit = curve.limit(side).0;
        let inside = (f64::from(limit) - peak.at) * f64::from(side.sign());
        // Among the first or last two samples.
        if inside < 1.5 * f64::from(STRIDE) {
            return Err(ScanRefusal::PeakAtEdge);
        }
        if curve.ahead(side) >= STRIDE {
            continue;
        }
        let end = curve.end(side);
        let error = root(peak.error * peak.error + sigma * sigma / f64::from(end.frames.max(1)));
        let doubt = if curve.noise().is_silent() { 0.0 } else { SURE * error };
        if peak.value - end.mean < EDGE_FALL * height + doubt {
            return Err(ScanRefusal::PeakAtEdge);
        }
    }
    Ok(())
}

/// Refuses two peaks, alike in height, further apart than the trap radius.
fn two_peaks(curve: &Curve, trap: i32, height: f64) -> Result<(), ScanRefusal> {
    let floor = (curve.floor() - curve.reference()) as f32;
    let sigma = curve.noise().relative() * magnitude(curve.reference() + height);
    if height < 2.0 * SURE * sigma {
        return Ok(());
    }
    let bins = || 0..Curve::BINS as i32;
    let Some((top, level)) =
        bins().filter_map(|i| Some((i, curve.bin(i)?.1))).reduce(|a, b| if b.1 > a.1 { b } else { a })
    else {
        return Ok(());
    };
    let place = curve.bin(top).map_or(0, |(p, _)| p.0);
    let share = |v: f32| (v - floor) / (level - floor);
    for side in [Side::Low, Side::High] {
        // Outwards from the top: how deep the curve falls, and whether it comes back.
        let mut lowest = level;
        for (p, v) in bins().filter_map(|d| curve.bin(top + (d + 1) * side.sign())) {
            if v < lowest {
                lowest = v;
            }
            // Between the middles of two bins lies up to a bin more than between what was seen of them.
            if ((p.0 - place).abs() - curve.bin_width()) as f32 > FAR * trap as f32
                && share(lowest) < APART
                && share(v) > ALIKE
            {
                return Err(ScanRefusal::TwoPeaks);
            }
        }
    }
    Ok(())
}

/// Refuses a curve whose values ran away at rest, or whose places had changed when they were visited again.
///
/// A sweep comes back over a place the other way, late by what is not calibrated: that is no change of light.
fn drifts(curve: &Curve, height: f64, top: f64, sweeping: bool) -> Result<(), ScanRefusal> {
    let rest = curve.rest();
    let sure = magnitude(rest.significance(curve.noise().relative() * magnitude(curve.reference()))) > RUNAWAY;
    if sure && magnitude(rest.slope()) * f64::from(curve.frames()) > DRIFT * height {
        return Err(ScanRefusal::LightDrifts);
    }
    let again = curve.revisits();
    if sweeping || again.frames < 2 {
        return Ok(());
    }
    let change = magnitude(again.mean);
    let error = 2.0 * curve.noise().relative() / root(f64::from(again.frames));
    if change * magnitude(top) > DRIFT * height && change > SURE * error {
        Err(ScanRefusal::LightDrifts)
    } else {
        Ok(())
    }
}

/// Significance of a slope at rest that is no chance. A pure slope over n frames, taken for noise, has √n.
const RUNAWAY: f64 = 4.8;

/// The minimum between two lobes.
#[derive(Clone, Copy, Debug)]
struct Valley {
    bottom: Peak,
    lesser_lobe: f64,
}

impl Valley {
    /// How far the lesser lobe rises above the bottom, relative to the greater one's rise.
    fn depth(&self, top: f64) -> f64 {
        (self.lesser_lobe - self.bottom.value) / (top - self.bottom.value)
    }

    /// Deep enough for the focus of a phase object, if that is what is looked for.
    fn is_focus(&self, top: f64) -> bool {
        self.depth(top) > 0.25
    }

    /// Contrast vanishes between two lobes that are both real: an unstained cell, not the two-lobed curve of an edge,
    /// whose minimum stays far above the background.
    fn vanishes(&self, top: f64, floor: f64) -> bool {
        self.depth(top) > 0.4
            && self.bottom.value - floor < 0.2 * (top - floor)
            && self.bottom.value < 0.55 * self.lesser_lobe
    }
}

/// The deepest minimum between the highest cell and another lobe within the trap radius.
fn valley(curve: &Curve, trap: i32, highest: Cell) -> Option<Valley> {
    let top = highest.x as i32;
    let silent = curve.noise().is_silent();
    let value = |p: Place| if silent { curve.mean(p) } else { curve.smooth(p) };
    let mut deepest: Option<Valley> = None;
    for side in [Side::Low, Side::High] {
        let (mut bottom, mut depth, mut found) = (f64::MAX, 0.0, None);
        let (mut at, mut lobe) = (Place(top), 0.0);
        for p in (1..=trap).map(|d| Place(top + d * side.sign())) {
            let Some(v) = value(p) else { continue };
            if v < bottom {
                (bottom, at) = (v, p);
            } else if v - bottom > depth {
                (depth, lobe, found) = (v - bottom, v, Some((at, bottom)));
            }
        }
        if let Some((place, bottom)) = found
            && deepest.is_none_or(|d| depth > d.lesser_lobe - d.bottom.value)
        {
            deepest = Some(Valley { bottom: lowest_near(curve, place, bottom)?, lesser_lobe: lobe });
        }
    }
    deepest
}

/// The parabola's bottom through a place and its neighbours a step away.
fn lowest_near(curve: &Curve, place: Place, value: f64) -> Option<Peak> {
    let cell = |p: i32| curve.at(Place(p)).map(|c| Cell { mean: curve.smooth(Place(p)).unwrap_or(c.mean), ..c });
    let beside = |sign: i32| (1..=8 * STRIDE).find_map(|d| cell(place.0 + d * sign));
    let mut middle = curve.at(place)?;
    let (mut low, mut high) = (beside(-1)?, beside(1)?);
    if curve.noise().is_silent() {
        let plain = |c: Cell, sign: i32| curve.at(Place(place.0 + sign * STRIDE)).unwrap_or(c);
        (low, high) = (plain(low, -1), plain(high, 1));
    } else {
        middle.mean = value;
    }
    Some(peak::parabola(middle, low, high))
}
