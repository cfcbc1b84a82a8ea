//! The way back: frames that cost no way, where the peak may be.
//!
//! Without noise, half steps at the tops that may yet win. With noise, more frames at every place that may yet be the
//! best, as many as the way made allows.

use super::curve::{Curve, Place, STRIDE, Side, magnitude};
use super::finding::Finding;
use super::peak::Peak;
use super::rivals::Rivals;
use super::search::{Next, Search};
use super::work::Slice;
use core::task::{Poll, ready};

/// Frames that a scan may take beyond two for each sample step of its way: averaging is not free.
const ALLOWANCE: i64 = 90;

/// Extra frames at one place at most.
const EXTRA: i64 = 12;

/// Standard deviations of one frame by which a place may look lower than the best and still be looked at again.
const PLAUSIBLE: f64 = 3.0;

/// How often the peak may turn out to be elsewhere.
const ROUNDS: u8 = 4;

/// Revisits for a look at the light, if there is no noise to be averaged.
const LOOKS: u32 = 3;

/// Frames that may still be taken.
pub fn allowance(curve: &Curve) -> i64 {
    ALLOWANCE + 2 * curve.travelled() - i64::from(curve.frames())
}

/// State of the way back.
#[derive(Clone, Debug)]
pub struct Refine {
    trap: i32,
    goal: Option<Place>,
    rounds: u8,
    thought: Thought,
}

/// What is being worked out for the next decision.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "a board has no heap, and one of them at a time")]
enum Thought {
    Nothing,
    /// Which half step is next: tops so far, and the nearest place that is missing.
    Splitting {
        rivals: Rivals,
        number: i32,
        next: Option<i32>,
    },
    /// Where the peak is.
    Finding(Finding),
    Found(Option<Place>),
}

impl Refine {
    /// The way back from where the search ended.
    pub fn new(trap: i32) -> Self {
        Self { trap, goal: None, rounds: ROUNDS, thought: Thought::Nothing }
    }

    /// The window around the best in which the peak is looked for.
    pub fn window(curve: &Curve, trap: i32) -> Option<(Place, Place)> {
        let (best, _) = curve.best()?;
        let (low, high) = (curve.seen(Side::Low).0, curve.seen(Side::High).0);
        Some((Place((best.0 - 2 * trap).max(low)), Place((best.0 + 2 * trap).min(high))))
    }

    /// Where frames are missing because they were forgotten on a long way: there the curve is taken again.
    fn forgotten(curve: &Curve, trap: i32) -> Option<Place> {
        let (best, _) = curve.best()?;
        let from = (best.0 - trap).max(curve.seen(Side::Low).0);
        let to = (best.0 + trap).min(curve.seen(Side::High).0);
        let here = curve.here().0;
        let places = (from..=to).filter(|p| p % STRIDE == 0 && curve.mean(Place(*p)).is_none());
        places.min_by_key(|p| (p - here).abs()).map(Place)
    }

    fn split(&mut self, curve: &Curve, slice: &mut Slice) -> Poll<Next> {
        let Some((from, to)) = Self::window(curve, self.trap) else { return Poll::Ready(Next::Enough) };
        let Thought::Splitting { rivals, number, next } = &mut self.thought else {
            self.thought = Thought::Splitting { rivals: Rivals::new(curve, from, to), number: 0, next: None };
            return self.split(curve, slice);
        };
        let here = curve.here().0;
        while let Some((p, top)) = ready!(rivals.next(curve, slice)) {
            *number += 1;
            // First the half step on the side where the top lies.
            let side = if top.at < f64::from(p.0) { -1 } else { 1 };
            let missing = |q: &i32| *q > from.0 && *q < to.0 && curve.mean(Place(*q)).is_none();
            let Some(q) = [p.0 + side, p.0 - side].into_iter().find(missing) else { continue };
            if next.is_none_or(|n| (q - here).abs() < (n - here).abs()) {
                *next = Some(q);
            }
        }
        Poll::Ready(match next {
            Some(place) if *number > 1 => Next::Sample(Place(*place)),
            _ => self.look(curve),
        })
    }

    /// A few places of the way back are looked at again: light that drifts shows.
    fn look(&self, curve: &Curve) -> Next {
        let Some((best, _)) = curve.best() else { return Next::Enough };
        let way = best.0 - curve.here().0;
        if curve.revisits().frames >= LOOKS || way.abs() < 2 * STRIDE {
            return Next::Enough;
        }
        // Halfway to the best, on a place of the way out.
        Next::Sample(Place(curve.here().0 + way / (2 * STRIDE) * STRIDE))
    }

    fn average(&mut self, curve: &Curve, slice: &mut Slice) -> Poll<Next> {
        let here = curve.here();
        let spare = allowance(curve);
        let goal = match self.goal {
            Some(goal) => goal,
            None => match ready!(self.find(curve, slice)) {
                Some(found) => *self.goal.insert(found),
                None => return Poll::Ready(Next::Enough),
            },
        };
        // While the peak is looked for anew, that is decided already.
        if !matches!(self.thought, Thought::Finding(_)) && self.again(curve, goal, spare) {
            return Poll::Ready(Next::Sample(here));
        }
        let goal = if goal == here {
            let Some(found) = ready!(self.find(curve, slice)) else { return Poll::Ready(Next::Enough) };
            if self.rounds == 0 || spare < 10 || (found.0 - here.0).abs() <= STRIDE {
                return Poll::Ready(Next::Enough);
            }
            self.rounds -= 1;
            self.goal = Some(found);
            found
        } else {
            goal
        };
        let step = (goal.0 - here.0).clamp(-1, 1);
        Poll::Ready(Next::Sample(Place(here.0 + step)))
    }

    /// Whether a place that may yet be the best is worth one more frame.
    fn again(&self, curve: &Curve, goal: Place, spare: i64) -> bool {
        let here = curve.here();
        let way = (goal.0 - here.0).abs() / STRIDE;
        let share = (spare / i64::from(way + 5)).clamp(0, EXTRA);
        let frames = curve.at(here).map_or(0, |c| i64::from(c.frames));
        let value = curve.smooth(here).unwrap_or(0.0);
        let best = curve.best().map_or(value, |(_, v)| v);
        let plausible = value > best - PLAUSIBLE * curve.noise().relative() * magnitude(value);
        plausible && spare > 0 && frames < i64::from(super::climb::FRAMES) + share
    }

    fn find(&mut self, curve: &Curve, slice: &mut Slice) -> Poll<Option<Place>> {
        let Some((from, to)) = Self::window(curve, self.trap) else { return Poll::Ready(None) };
        match &mut self.thought {
            Thought::Found(found) => Poll::Ready(*found),
            Thought::Finding(finding) => {
                let found = ready!(finding.step(curve, slice)).map(|Peak { at, .. }| {
                    let place = (if at < 0.0 { at - 0.5 } else { at + 0.5 }) as i32;
                    Place(place.clamp(from.0, to.0))
                });
                self.thought = Thought::Found(found);
                Poll::Ready(found)
            }
            _ => {
                self.thought = Thought::Finding(Finding::new(from, to));
                self.find(curve, slice)
            }
        }
    }
}

impl Search for Refine {
    fn next(&mut self, curve: &Curve) -> Next {
        if matches!(self.thought, Thought::Nothing)
            && let Some(place) = Self::forgotten(curve, self.trap)
        {
            return Next::Sample(place);
        }
        let mut slice = Slice::new();
        let next =
            if curve.noise().is_silent() { self.split(curve, &mut slice) } else { self.average(curve, &mut slice) };
        let Poll::Ready(next) = next else { return Next::Thinking };
        self.thought = Thought::Nothing;
        next
    }
}
