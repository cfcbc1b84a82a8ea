//! The default search: find the uphill direction against the noise, one pass uphill, a trap radius past the best.
//!
//! Under the assumption that all local maxima lie within the trap radius of the peak, a place from which the values fall
//! for a trap radius to both sides is the peak, and nothing less shows it. So the climb goes on until both sides are
//! seen; all that is to be gained is in the order. Where nothing is decided yet, the way goes on in one direction, as a
//! sequential test: it turns when the line through everything seen falls significantly, the sooner the less of the
//! range lies ahead and the more behind (the peak is as likely anywhere). Noise costs frames, not way: frames at the
//! start and at the end of the first probe, two at each place, as many as way is made, and the rest on the way back
//! ([`super::refine`]).

use core::cell::Cell;
use core::f64::consts::SQRT_2;

use super::curve::{Curve, Place, STRIDE, Side, magnitude};
use super::exact::doubled;
use super::noise::root;
use super::refine::{self, Refine};
use super::rivals::Rivals;
use super::search::{Lengths, Next, Search};
use super::work::Slice;
use core::task::{Poll, ready};

/// Equal frames at the start after which the values are taken to be free of noise.
const SILENCE: u32 = 3;

/// Frames at the start, to learn the noise and to compare with, if there is noise.
const SENSE: u32 = 32;

/// Frames at the end of the first probe while the direction is not decided.
const STAY: u16 = 32;

/// Frames at each place on the way, if there is noise.
pub const FRAMES: u16 = 2;

/// A line falling by this many standard errors turns the climb, if as much of the range lies ahead as behind.
const TURN: f64 = 2.0;

/// What is added to [`TURN`] if all of the range lies ahead, and taken off if all lies behind.
const ODDS: f64 = 1.6;

/// A fall from the best place of this many standard errors is beyond doubt: the best was picked among hundreds.
const FALL: f64 = 5.5;

/// The same for the mean over [`BROAD`] to both sides of the best, which is picked among fewer.
const BROAD_FALL: f64 = 4.0;

/// A rise of this share of the curve's height is steep,
const STEEP: f64 = 0.02;

/// if it is this share of the value.
const STEEP_AT_ALL: f64 = 0.005;

/// A second difference over steps of this share of the curve's height is sharp,
const SHARP: f64 = 1e-3;

/// if it is this share of the value.
const SHARP_AT_ALL: f64 = 2e-4;

/// Half a broad top, in places.
const BROAD: i32 = 4 * STRIDE;

/// State of a climb.
#[derive(Clone, Debug)]
pub struct Climb {
    lengths: Lengths,
    heading: Option<Side>,
    turned: bool,
    way: Way,
}

/// Which way it goes, and what is being worked out for the next decision.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "a board has no heap, and one of them at a time")]
enum Way {
    Out(Thought),
    Back(Refine),
}

/// What is known of the curve as it is.
#[derive(Clone, Debug, Default)]
struct Thought {
    /// By side.
    done: [Option<bool>; 2],
    /// Tops that may be the best, and the farthest of them so far.
    first: Option<(Rivals, Option<Place>)>,
}

/// What it costs to see whether a side is done, and which way to go; with noise there are roots to draw.
const DONE: i32 = 800;
const NOISY_DONE: i32 = 10_000;
const NOISY_HEADING: i32 = 6_000;

impl Climb {
    /// A climb with these lengths.
    pub fn new(lengths: Lengths) -> Self {
        Self { lengths, heading: None, turned: false, way: Way::Out(Thought::default()) }
    }

    /// The next place on the way out; `None` when both sides are seen.
    fn walk(&mut self, curve: &Curve, heading: Side, slice: &mut Slice) -> Poll<Option<Place>> {
        let here = curve.here();
        let quiet = curve.noise().is_silent();
        let frames = || curve.at(here).map_or(0, |c| c.frames);
        let spare = !self.lengths.sweeping && !quiet && refine::allowance(curve) > 0;
        if spare && here.0 != 0 && frames() < FRAMES {
            return Poll::Ready(Some(here));
        }
        let (low, high) = (ready!(self.done(curve, Side::Low, slice)), ready!(self.done(curve, Side::High, slice)));
        if !slice.affords(if quiet { DONE } else { NOISY_HEADING }) {
            return Poll::Pending;
        }
        let heading = match (low, high) {
            (true, true) => return Poll::Ready(None),
            (true, false) => Side::High,
            (false, true) => Side::Low,
            (false, false) => {
                // What takes many software floats is worked out where it decides, and once.
                let known = Cell::new(None);
                let work_out = || {
                    let sigma = curve.noise().relative() * magnitude(curve.reference());
                    let significance = curve.trend().significance(sigma);
                    known.set(Some(significance));
                    significance
                };
                let rise = || {
                    let significance = known.get().unwrap_or_else(work_out);
                    if heading == Side::Low { -significance } else { significance }
                };
                let probed = here.0 == self.lengths.probe * heading.sign() && curve.seen(heading.other()).0 == 0;
                if spare && probed && frames() < STAY && magnitude(rise()) < TURN + ODDS {
                    return Poll::Ready(Some(here));
                }
                let falls = || {
                    let rise = rise();
                    let (ahead, behind) = (f64::from(curve.ahead(heading)), f64::from(curve.ahead(heading.other())));
                    rise < 0.0 && rise < -(TURN + ODDS * (ahead - behind) / (ahead + behind))
                };
                let begun = curve.seen(heading).0 * heading.sign() >= if quiet { STRIDE } else { 2 * STRIDE };
                if quiet && !self.turned && self.top_between(curve, heading) {
                    self.turned = true;
                    self.heading = Some(heading.other());
                    return Poll::Ready(Some(self.step(curve, heading.other(), quiet)));
                }
                if self.turned {
                    return Poll::Ready(Some(self.step(curve, heading, quiet)));
                }
                // A fall behind means that a top is being crossed: its far side comes first.
                if begun && falls() && !fell(curve, heading.other()) { heading.other() } else { heading }
            }
        };
        self.heading = Some(heading);
        Poll::Ready(Some(self.step(curve, heading, quiet)))
    }

    /// The next place in a direction.
    fn step(&self, curve: &Curve, heading: Side, quiet: bool) -> Place {
        let seen = curve.seen(heading).0;
        let half = !self.lengths.sweeping && quiet && (steep(curve, heading) || sharp(curve, heading));
        // Off the grid a half step leads back to it.
        let step = if half || seen % STRIDE != 0 { 1 } else { STRIDE };
        Place(seen + heading.sign() * step)
    }

    /// Whether a trap radius was looked at in one direction, with a top in the farther half of it. The peak may still be
    /// behind the start, and then all that remains is seen from there; finishing this side first would cost the way back from
    /// far past that top. The bound is the same as when the top is the peak: 4½ trap radii.
    fn top_between(&self, curve: &Curve, heading: Side) -> bool {
        let trap = self.lengths.trap;
        let top = curve.best().map_or(0, |(best, _)| best.0 * heading.sign());
        let seen = curve.seen(heading).0 * heading.sign();
        seen >= trap && (trap / 2 + STRIDE..=trap).contains(&top) && top + STRIDE <= seen
    }

    /// Of the tops that may be the best, the farthest from one side. All local maxima lie within the trap radius of the peak: so
    /// does the peak of this one.
    fn first(&mut self, curve: &Curve, best: Place, side: Side, slice: &mut Slice) -> Poll<Place> {
        let Way::Out(thought) = &mut self.way else { return Poll::Ready(best) };
        let (rivals, first) = thought.first.get_or_insert_with(|| {
            let (far, near) = (best.0 - side.sign() * self.lengths.trap, best.0 + side.sign() * STRIDE);
            (Rivals::new(curve, Place(far.min(near)), Place(far.max(near))), None)
        });
        while let Some((place, _)) = ready!(rivals.next(curve, slice)) {
            if first.is_none_or(|first| place.0 * side.sign() < first.0 * side.sign()) {
                *first = Some(place);
            }
        }
        let first = first.unwrap_or(best);
        thought.first = None;
        Poll::Ready(first)
    }

    /// Whether a side needs no more looking at.
    fn done(&mut self, curve: &Curve, side: Side, slice: &mut Slice) -> Poll<bool> {
        if let Way::Out(Thought { done, .. }) = &self.way
            && let Some(known) = done[side as usize]
        {
            return Poll::Ready(known);
        }
        let done = ready!(self.is_done(curve, side, slice));
        if let Way::Out(thought) = &mut self.way {
            thought.done[side as usize] = Some(done);
        }
        Poll::Ready(done)
    }

    fn is_done(&mut self, curve: &Curve, side: Side, slice: &mut Slice) -> Poll<bool> {
        let Some((best, _)) = curve.best() else { return Poll::Ready(false) };
        let past = |p: Place| (curve.seen(side).0 - p.0) * side.sign();
        let quiet = curve.noise().is_silent();
        if quiet && rises(curve, side) {
            // A top right at the end must be crossed.
            return Poll::Ready(curve.ahead(side) < STRIDE);
        }
        if curve.ahead(side) < STRIDE {
            return Poll::Ready(true);
        }
        // What costs most comes last.
        let far = past(best) >= self.lengths.trap;
        if !(far || (quiet && past(best) > STRIDE)) {
            return Poll::Ready(false);
        }
        // Once begun, the search among the tops is beyond that.
        let begun = matches!(&self.way, Way::Out(Thought { first: Some(_), .. }));
        if !begun {
            if !slice.affords(if quiet { DONE } else { NOISY_DONE }) {
                return Poll::Pending;
            }
            if !fell(curve, side) {
                return Poll::Ready(false);
            }
        }
        Poll::Ready(far || past(ready!(self.first(curve, best, side, slice))) >= self.lengths.trap)
    }
}

/// Whether the curve has risen steeply over the last two steps: a narrow top may follow, so the steps are halved.
fn steep(curve: &Curve, heading: Side) -> bool {
    let here = curve.here().0;
    let (Some(value), Some((_, best))) = (curve.mean(Place(here)), curve.best()) else { return false };
    let behind = (1..=2 * STRIDE).filter_map(|d| curve.mean(Place(here - d * heading.sign())));
    // Downhill that is found out without software floats.
    let mut rises = behind.filter(|v| value.total_cmp(v).is_gt()).map(|v| value - v);
    rises.any(|rise| rise > STEEP * (best - curve.floor()) && rise > STEEP_AT_ALL * magnitude(best))
}

/// Whether the curve rises at the end of a side so that a top there may become the best.
fn rises(curve: &Curve, side: Side) -> bool {
    let end = curve.seen(side).0;
    let behind = |d: i32| curve.mean(Place(end - d * side.sign()));
    let (Some(last), Some(before)) = (behind(0), behind(1).or(behind(STRIDE))) else { return false };
    let (Some(earlier), Some((_, best))) = (behind(2 * STRIDE), curve.best()) else { return false };
    last > before && best - last < last - earlier
}

/// Whether the curve bends sharply over the last two steps: what a narrow top may hide between samples is worth half steps.
fn sharp(curve: &Curve, heading: Side) -> bool {
    let here = curve.here().0;
    let Some((_, best)) = curve.best() else { return false };
    let behind = |d: i32| curve.mean(Place(here - d * STRIDE * heading.sign()));
    let (Some(a), Some(b), Some(c)) = (behind(0), behind(1), behind(2)) else { return false };
    let bend = magnitude(a - doubled(b) + c);
    bend > SHARP * (best - curve.floor()) && bend > SHARP_AT_ALL * magnitude(best)
}

/// Whether the values fall from the best place to the end seen on one side, beyond doubt.
pub fn fell(curve: &Curve, side: Side) -> bool {
    let Some((best, top)) = curve.best() else { return false };
    let end = curve.end(side);
    if end.frames == 0 {
        return false;
    }
    if curve.noise().is_none() {
        return top > end.mean;
    }
    let sigma = curve.noise().relative() * magnitude(top);
    if curve.noise().is_silent() {
        // One frame against one.
        return top - end.mean > FALL * SQRT_2 * sigma;
    }
    let error = |variance: f64| sigma * root(1.0 / f64::from(end.frames) + variance);
    let broad = curve.level(Place(best.0 - BROAD), Place(best.0 + BROAD));
    top - end.mean > FALL * error(curve.smooth_variance(best))
        || (broad.frames > 0 && broad.mean - end.mean > BROAD_FALL * error(1.0 / f64::from(broad.frames)))
}

impl Search for Climb {
    fn next(&mut self, curve: &Curve) -> Next {
        if let Way::Back(refine) = &mut self.way {
            return refine.next(curve);
        }
        let sense = if curve.noise().is_none() { SILENCE } else { SENSE };
        let heading = match self.heading {
            Some(heading) => heading,
            None if curve.frames() < sense => return Next::Sample(Place(0)),
            // The longer side first.
            None if curve.ahead(Side::High) >= curve.ahead(Side::Low) => Side::High,
            None => Side::Low,
        };
        self.heading = Some(heading);
        let Poll::Ready(walked) = self.walk(curve, heading, &mut Slice::new()) else { return Next::Thinking };
        match walked {
            Some(place) => {
                self.way = Way::Out(Thought::default());
                Next::Sample(place)
            }
            None if self.lengths.sweeping => Next::Enough,
            None => {
                self.way = Way::Back(Refine::new(self.lengths.trap));
                Next::Thinking
            }
        }
    }
}
