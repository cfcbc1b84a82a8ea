//! What came of it: a peak, the focus of a phase object, or the reason why the curve makes no sense.

use super::climb::fell;
use super::curve::{Cell, Curve, Place, STRIDE, Side, magnitude};
use super::finding::Finding;
use super::noise::root;
use super::peak::Peak;
use super::refine::Refine;
use super::valley::{Deepest, Valley};
use super::work::Slice;
use core::task::{Poll, ready};
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

/// What it costs to look for the highest place, and to weigh one reason against the curve; with noise there are roots to draw.
const HIGHEST: i32 = 8_000;
const REASON: i32 = 3_000;
const NOISY_REASON: i32 = 10_000;
const PEAKS: i32 = 10_000;

/// What is to be looked at next; in this order.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "a board has no heap, and one of them at a time")]
enum Look {
    Highest,
    Peak { highest: Cell, finding: Finding },
    Valley { found: Option<Peak>, peak: Peak, deepest: Deepest },
    Reason { found: Option<Peak>, peak: Peak, valley: Option<Valley>, reason: Reason },
}

/// Why the curve may be refused, in the order in which it is.
#[derive(Clone, Copy, Debug)]
enum Reason {
    Runaway,
    Revisits,
    Edge(Side),
    NoFall(Side),
    Vanishing,
    TwoPeaks(Side),
    NoPeak,
}

impl Reason {
    fn next(self) -> Self {
        match self {
            Reason::Runaway => Reason::Revisits,
            Reason::Revisits => Reason::Edge(Side::Low),
            Reason::Edge(Side::Low) => Reason::Edge(Side::High),
            Reason::Edge(Side::High) => Reason::NoFall(Side::Low),
            Reason::NoFall(Side::Low) => Reason::NoFall(Side::High),
            Reason::NoFall(Side::High) => Reason::Vanishing,
            Reason::Vanishing => Reason::TwoPeaks(Side::Low),
            Reason::TwoPeaks(Side::Low) => Reason::TwoPeaks(Side::High),
            Reason::TwoPeaks(Side::High) | Reason::NoPeak => Reason::NoPeak,
        }
    }
}

/// The judgement of a finished search.
#[derive(Clone, Debug)]
pub struct Judging {
    trap: i32,
    subject: Subject,
    sweeping: bool,
    look: Look,
}

impl Judging {
    /// Begins; `trap` in places.
    pub fn new(trap: i32, subject: Subject, sweeping: bool) -> Self {
        Self { trap, subject, sweeping, look: Look::Highest }
    }

    /// Goes on with the same curve. The answer is where the focus is, in places, and how high the peak.
    ///
    /// # Errors
    /// The reason why the curve has no focus that can be trusted.
    pub fn step(&mut self, curve: &Curve, slice: &mut Slice) -> Poll<Result<Peak, ScanRefusal>> {
        loop {
            match &mut self.look {
                Look::Highest => {
                    if !slice.affords(HIGHEST) {
                        return Poll::Pending;
                    }
                    let Some((from, to)) = Refine::window(curve, self.trap) else {
                        return Poll::Ready(Err(ScanRefusal::SamplesStopped));
                    };
                    let best = curve.best().map_or(0.0, |(_, v)| v);
                    if best <= curve.floor() && curve.noise().is_none() {
                        return Poll::Ready(Err(ScanRefusal::NoContrast));
                    }
                    let values = (from.0..=to.0).filter_map(|p| Some((p, curve.mean(Place(p))?)));
                    let highest = values.reduce(|a, b| if b.1.total_cmp(&a.1).is_gt() { b } else { a });
                    let Some(highest) = highest.and_then(|(p, _)| curve.at(Place(p))) else {
                        return Poll::Ready(Err(ScanRefusal::SamplesStopped));
                    };
                    self.look = Look::Peak { highest, finding: Finding::new(from, to) };
                }
                Look::Peak { highest, finding } => {
                    let found = ready!(finding.step(curve, slice));
                    let Cell { x, mean, .. } = *highest;
                    let peak = found.unwrap_or(Peak { at: x, value: mean, error: 0.0, window: 1 });
                    self.look = Look::Valley { found, peak, deepest: Deepest::new(self.trap, *highest) };
                }
                Look::Valley { found, peak, deepest } => {
                    let valley = ready!(deepest.step(curve, slice));
                    if self.subject == Subject::PhaseObject {
                        let focus = valley.filter(|v| v.is_focus(peak.value)).map(|v| v.bottom);
                        return Poll::Ready(focus.ok_or(ScanRefusal::NoSignificantPeak));
                    }
                    self.look = Look::Reason { found: *found, peak: *peak, valley, reason: Reason::Runaway };
                }
                Look::Reason { found, peak, valley, reason } => {
                    let cost = if curve.noise().is_silent() { REASON } else { NOISY_REASON };
                    if !slice.affords(if matches!(reason, Reason::TwoPeaks(_)) { PEAKS } else { cost }) {
                        return Poll::Pending;
                    }
                    let height = peak.value - curve.floor();
                    let vanishes = || valley.is_some_and(|v| v.vanishes(peak.value, curve.floor()));
                    let refusal = match *reason {
                        Reason::Runaway => runs_away(curve, height),
                        Reason::Revisits if self.sweeping => None,
                        Reason::Revisits => has_changed(curve, height, peak.value),
                        Reason::Edge(side) => at_edge(curve, peak, height, side),
                        Reason::NoFall(side) => (!fell(curve, side)).then_some(ScanRefusal::NoSignificantPeak),
                        Reason::Vanishing => vanishes().then_some(ScanRefusal::PhaseObject),
                        Reason::TwoPeaks(side) => two_peaks(curve, self.trap, height, side),
                        Reason::NoPeak => return Poll::Ready(found.ok_or(ScanRefusal::NoSignificantPeak)),
                    };
                    if let Some(why) = refusal {
                        return Poll::Ready(Err(why));
                    }
                    *reason = reason.next();
                }
            }
        }
    }
}

/// Refuses a peak at an end of the range, or one from which the curve does not fall towards an end that was reached.
fn at_edge(curve: &Curve, peak: &Peak, height: f64, side: Side) -> Option<ScanRefusal> {
    let limit = curve.limit(side).0;
    let inside = (f64::from(limit) - peak.at) * f64::from(side.sign());
    // Among the first or last two samples.
    if inside < 1.5 * f64::from(STRIDE) {
        return Some(ScanRefusal::PeakAtEdge);
    }
    if curve.ahead(side) >= STRIDE {
        return None;
    }
    let end = curve.end(side);
    let doubt = if curve.noise().is_silent() {
        0.0
    } else {
        let sigma = curve.noise().relative() * magnitude(peak.value);
        SURE * root(peak.error * peak.error + sigma * sigma / f64::from(end.frames.max(1)))
    };
    (peak.value - end.mean < EDGE_FALL * height + doubt).then_some(ScanRefusal::PeakAtEdge)
}

/// Refuses two peaks, alike in height, further apart than the trap radius: the other one on this side of the highest.
fn two_peaks(curve: &Curve, trap: i32, height: f64, side: Side) -> Option<ScanRefusal> {
    let floor = (curve.floor() - curve.reference()) as f32;
    let sigma = curve.noise().relative() * magnitude(curve.reference() + height);
    if height < 2.0 * SURE * sigma {
        return None;
    }
    let bins = (0..Curve::BINS as i32).filter_map(|i| Some((i, curve.bin(i)?)));
    let (top, (place, level)) = bins.reduce(|a, b| if b.1.1 > a.1.1 { b } else { a })?;
    let share = |v: f32| (v - floor) / (level - floor);
    // Between the middles of two bins lies up to a bin more than between what was seen of them.
    let far = FAR * trap as f32;
    let width = curve.bin_width();
    // Outwards from the top: how deep the curve falls, and whether it comes back.
    let outwards = if side == Side::Low { top } else { Curve::BINS as i32 - 1 - top };
    let mut lowest = level;
    for (p, v) in (1..=outwards).filter_map(|d| curve.bin(top + d * side.sign())) {
        if v < lowest {
            lowest = v;
        }
        if ((p.0 - place.0).abs() - width) as f32 > far && share(lowest) < APART && share(v) > ALIKE {
            return Some(ScanRefusal::TwoPeaks);
        }
    }
    None
}

/// Refuses a curve whose values ran away at rest.
fn runs_away(curve: &Curve, height: f64) -> Option<ScanRefusal> {
    let rest = curve.rest();
    let sure = magnitude(rest.significance(curve.noise().relative() * magnitude(curve.reference()))) > RUNAWAY;
    let far = || magnitude(rest.slope()) * f64::from(curve.frames()) > DRIFT * height;
    (sure && far()).then_some(ScanRefusal::LightDrifts)
}

/// Refuses a curve whose places had changed when they were visited again.
///
/// A sweep comes back over a place the other way, late by what is not calibrated: that is no change of light.
fn has_changed(curve: &Curve, height: f64, top: f64) -> Option<ScanRefusal> {
    let again = curve.revisits();
    if again.frames < 2 {
        return None;
    }
    let change = magnitude(again.mean);
    let far = change * magnitude(top) > DRIFT * height;
    let error = || 2.0 * curve.noise().relative() / root(f64::from(again.frames));
    (far && change > SURE * error()).then_some(ScanRefusal::LightDrifts)
}

/// Significance of a slope at rest that is no chance. A pure slope over n frames, taken for noise, has √n.
const RUNAWAY: f64 = 4.8;
