//! The highest peak between two places.
//!
//! With noise each local maximum is fitted in windows that widen for as long as one smooth peak explains what they hold
//! (χ², after Lepski 1991: the widest window that the data do not contradict has the least error). A narrow bump keeps its
//! narrow window, a broad top gets a wide one; the highest lower confidence bound wins.

use super::curve::{Curve, Place, STRIDE, Side, magnitude};
use super::fit::{Fit, Fitting, MOST, Model};
use super::noise::root;
use super::peak::{Peak, beside, parabola};
use super::rivals::Summits;
use super::work::Slice;
use core::task::{Poll, ready};

/// Half-widths of the windows, in places.
const WINDOWS: [i32; 12] = [2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 88];

const _: () = assert!(WINDOWS[WINDOWS.len() - 1] as usize * 2 + 1 == MOST);

/// Standard errors taken off a peak's height, because the highest of many was picked.
const CAUTION: f64 = 3.0;

/// Standard deviations of one frame below the best at which a maximum is not worth a fit.
const HOPELESS: f64 = 3.0;

/// What of the curve's height the smoothing may take off a narrow top.
const SMOOTHED: f64 = 0.1;

/// Standard deviations of χ² above its mean at which a window is contradicted.
const MISFIT: f64 = 2.5;

/// What it costs to begin, to look at a place, to compare one with its neighbours, to begin with one, and to judge a fit.
const BEGIN: i32 = 4_000;
const PLACE: i32 = 500;
const COMPARED: i32 = 3_000;
const BEGUN: i32 = 6_000;
const JUDGED: i32 = 4_000;

/// The search for it.
#[derive(Clone, Debug)]
pub struct Finding {
    from: Place,
    to: Place,
    way: Way,
    best: Option<Peak>,
}

#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "a board has no heap, and one of them at a time")]
enum Way {
    Begin,
    /// Without noise the tops say all.
    Silent(Summits),
    /// The next place; a value below `least` is not worth a fit.
    Noisy {
        next: i32,
        least: f64,
        candidate: Option<Candidate>,
        widening: Option<Widening>,
    },
}

/// A place that may be worth a fit.
#[derive(Clone, Copy, Debug)]
enum Candidate {
    /// It is high enough.
    High { place: Place, value: f64 },
    /// Its neighbours are lower.
    Top { place: Place },
}

impl Finding {
    /// Begins.
    pub fn new(from: Place, to: Place) -> Self {
        Self { from, to, way: Way::Begin, best: None }
    }

    /// Goes on: the highest peak, if there is one.
    pub fn step(&mut self, curve: &Curve, slice: &mut Slice) -> Poll<Option<Peak>> {
        loop {
            match &mut self.way {
                Way::Begin if curve.noise().is_silent() => {
                    self.way = Way::Silent(Summits::new(curve, self.from, self.to));
                }
                Way::Begin => {
                    if !slice.affords(BEGIN) {
                        return Poll::Pending;
                    }
                    let Some((_, best)) = curve.best() else { return Poll::Ready(None) };
                    // A narrow top loses up to a fifth of itself to the smoothing, and more to lying between two samples.
                    let noise = HOPELESS * curve.noise().relative() * magnitude(best);
                    let least = best - noise - SMOOTHED * (best - curve.floor());
                    self.way = Way::Noisy { next: self.from.0, least, candidate: None, widening: None };
                }
                Way::Silent(summits) => {
                    let Some((_, top)) = ready!(summits.next(curve, slice)) else { return Poll::Ready(self.best) };
                    if self.best.is_none_or(|best| top.value > best.value) {
                        self.best = Some(top);
                    }
                }
                Way::Noisy { next, least, candidate, widening } => {
                    if let Some(running) = widening {
                        let peak = ready!(running.step(curve, slice));
                        *widening = None;
                        let bound = |p: &Peak| p.value - CAUTION * p.error;
                        if self.best.is_none_or(|best| bound(&peak) > bound(&best)) {
                            self.best = Some(peak);
                        }
                        continue;
                    }
                    match *candidate {
                        None if *next > self.to.0 => return Poll::Ready(self.best),
                        None => {
                            if !slice.affords(PLACE) {
                                return Poll::Pending;
                            }
                            let place = Place(*next);
                            *next += 1;
                            let value = curve.smooth(place).filter(|value| *value > *least);
                            *candidate = value.map(|value| Candidate::High { place, value });
                        }
                        Some(Candidate::High { place, value }) => {
                            if !slice.affords(COMPARED) {
                                return Poll::Pending;
                            }
                            *candidate = is_local_maximum(curve, place, value).then_some(Candidate::Top { place });
                        }
                        Some(Candidate::Top { place }) => {
                            if !slice.affords(BEGUN) {
                                return Poll::Pending;
                            }
                            *candidate = None;
                            *widening = Widening::new(curve, place);
                        }
                    }
                }
            }
        }
    }
}

fn is_local_maximum(curve: &Curve, place: Place, value: f64) -> bool {
    let higher = |p: i32| curve.smooth(Place(p)).is_some_and(|v| v > value);
    !(1..=2 * STRIDE).any(|d| higher(place.0 - d) || higher(place.0 + d))
}

/// Looks for the widest window around a local maximum that one smooth peak explains.
#[derive(Clone, Debug)]
struct Widening {
    sigma: f64,
    best: Peak,
    bend: Option<f64>,
    window: usize,
    fitting: Option<Fitting>,
    /// The first fit in this window, and the vertex it found.
    first: Option<(Fit, f64)>,
}

impl Widening {
    fn new(curve: &Curve, place: Place) -> Option<Self> {
        let cell = curve.at(place)?;
        let sigma = curve.noise().relative() * magnitude(cell.mean);
        let mut best = match (beside(curve, place, -1), beside(curve, place, 1)) {
            (Some(low), Some(high)) => parabola(cell, low, high),
            _ => Peak { at: cell.x, value: cell.mean, error: 0.0, window: 1 },
        };
        best.error = sigma / root(f64::from(cell.frames));
        Some(Self { sigma, best, bend: None, window: 0, fitting: None, first: None })
    }

    fn step(&mut self, curve: &Curve, slice: &mut Slice) -> Poll<Peak> {
        loop {
            let Some(&half) = WINDOWS.get(self.window) else { return Poll::Ready(self.best) };
            let Some(fitting) = &mut self.fitting else {
                if !slice.affords(JUDGED) {
                    return Poll::Pending;
                }
                let middle = Place((if self.best.at < 0.0 { self.best.at - 0.5 } else { self.best.at + 0.5 }) as i32);
                let (from, to) = (Place(middle.0 - half), Place(middle.0 + half));
                if curve.seen(Side::Low) > from || curve.seen(Side::High) < to {
                    return Poll::Ready(self.best);
                }
                let model = Model { from, to, sigma: self.sigma, bend: self.bend };
                self.fitting = Fitting::new(curve, model, self.best.at);
                if self.fitting.is_none() {
                    self.window += 1;
                }
                continue;
            };
            let fit = ready!(fitting.step(curve, slice));
            let usable = |f: &Fit| f.bend > 0.0 && magnitude(f.shift) < 0.5 * f64::from(half);
            let Some((first, vertex)) = self.first else {
                let contradicted = |f: &Fit| f.freedom > 0.0 && f.misfit > f.freedom + MISFIT * root(2.0 * f.freedom);
                match fit {
                    Some(fit) if contradicted(&fit) => return Poll::Ready(self.best),
                    Some(fit) if usable(&fit) => {
                        let vertex = self.best.at + fit.shift;
                        self.first = Some((fit, vertex));
                        fitting.again(fit.bend, vertex);
                    }
                    // Too narrow to see the bend through the noise: a wider one may.
                    _ => self.next_window(),
                }
                continue;
            };
            let (fit, at) = match fit.filter(usable) {
                Some(better) => (better, vertex + better.shift),
                None => (first, vertex),
            };
            self.bend = Some(fit.bend);
            // Few frames far apart, as in a sweep: more terms than they can carry.
            let overstretched = fit.error > self.best.error && self.best.error > 0.0;
            if !overstretched {
                self.best = Peak { at, value: fit.top, error: fit.error, window: half };
            }
            self.next_window();
        }
    }

    fn next_window(&mut self) {
        self.window += 1;
        (self.fitting, self.first) = (None, None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autofocus::judge::Judging;
    use parfocal_protocol::autofocus::{ScanRefusal, Subject};
    use parfocal_protocol::units::{FocusValue, Nanometres};
    use proptest::prelude::*;

    /// A curve seen from end to end, two frames a place, one every `step` places.
    fn seen(peaks: &[(f64, f64, f64)], noise: f64, step: i32, seed: u32) -> Curve {
        let um = |z: i32| Nanometres(z * 1000);
        let mut curve = Curve::new(um(0), um(-30), um(30), Nanometres(500));
        let mut state = seed;
        let mut deviate = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 23) - 1.0
        };
        for place in (0..=120).chain(-120..0).filter(|p| p % step == 0) {
            for _ in 0..2 {
                let z = curve.position(Place(place));
                let at = f64::from(place) / 4.0;
                let phi: f64 = peaks.iter().map(|(h, c, w)| h / (1.0 + ((at - c) / w).powi(2))).sum();
                curve.add(z, FocusValue((0.1 + phi) * (1.0 + noise * deviate())));
            }
        }
        curve
    }

    fn finish<T>(mut step: impl FnMut(&mut Slice) -> Poll<T>, instructions: i32) -> T {
        loop {
            if let Poll::Ready(done) = step(&mut Slice::of(instructions)) {
                return done;
            }
        }
    }

    fn same(a: &Peak, b: &Peak) -> bool {
        a.at.to_bits() == b.at.to_bits()
            && a.value.to_bits() == b.value.to_bits()
            && a.error.to_bits() == b.error.to_bits()
            && a.window == b.window
    }

    proptest! {
        #[test]
        fn how_work_is_cut_makes_no_difference(
            peaks in proptest::collection::vec((0.05f64..1.0, -25.0f64..25.0, 1.0f64..12.0), 1..4),
            noise in prop_oneof![Just(0.0), Just(1e-5), Just(0.001), Just(0.03)],
            step in prop_oneof![Just(1), Just(2)],
            seed: u32,
            instructions in 1i32..30_000,
        ) {
            let curve = seen(&peaks, noise, step, seed);
            let (from, to) = (Place(-100), Place(100));
            let found = |instructions| {
                let mut finding = Finding::new(from, to);
                finish(|slice| finding.step(&curve, slice), instructions)
            };
            let (whole, cut) = (found(i32::MAX), found(instructions));
            prop_assert!(whole.zip(cut).is_none_or(|(a, b)| same(&a, &b)) && whole.is_some() == cut.is_some());
            for subject in [Subject::Peak, Subject::PhaseObject] {
                let judged = |instructions| -> Result<Peak, ScanRefusal> {
                    let mut judging = Judging::new(40, subject, false);
                    finish(|slice| judging.step(&curve, slice), instructions)
                };
                match (judged(i32::MAX), judged(instructions)) {
                    (Ok(a), Ok(b)) => prop_assert!(same(&a, &b)),
                    (a, b) => prop_assert_eq!(a.err(), b.err()),
                }
            }
        }
    }
}
