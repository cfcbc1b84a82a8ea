//! The tops of a curve, one after the other, and those that may yet be the highest.

use super::curve::{Curve, Place, Side, magnitude};
use super::peak::{APART, Peak, top, value_beside};
use super::work::Slice;
use core::task::{Poll, ready};
use heapless::Vec;

/// Tops that are kept while the highest is looked for.
const TOPS: usize = 16;

/// What it costs to look at a place,
const PLACE: i32 = 100;

/// to look up a top,
const KEPT: i32 = 200;

/// and to work one out.
const WORKED_OUT: i32 = 8_000;

/// Every [`top`] between two places, with its place.
#[derive(Clone, Debug)]
pub struct Summits {
    next: i32,
    to: i32,
    end: i32,
    /// The known place before: its value, and whether that is not lower than the one before it.
    last: Option<(i32, f64, bool)>,
    /// A summit whose height is not worked out yet.
    summit: Option<Place>,
}

impl Summits {
    /// From the first one on.
    pub fn new(curve: &Curve, from: Place, to: Place) -> Self {
        // Nothing is known beyond what was seen.
        let end = (to.0 + APART).min(curve.seen(Side::High).0);
        Self { next: from.0, to: to.0, end, last: None, summit: None }
    }

    /// The next one, if there is one.
    pub fn next(&mut self, curve: &Curve, slice: &mut Slice) -> Poll<Option<(Place, Peak)>> {
        loop {
            if let Some(place) = self.summit {
                if !slice.affords(if curve.tops().at(place).is_some() { KEPT } else { WORKED_OUT }) {
                    return Poll::Pending;
                }
                self.summit = None;
                if let Some(peak) = top(curve, place) {
                    return Poll::Ready(Some((place, peak)));
                }
                continue;
            }
            if self.last.is_some_and(|l| l.0 > self.to) || self.next > self.end {
                return Poll::Ready(None);
            }
            if !slice.affords(PLACE) {
                return Poll::Pending;
            }
            let here = self.next;
            self.next += 1;
            // Values are compared without software floats: most places are no top.
            let Some(value) = curve.mean(Place(here)) else { continue };
            let rose = match self.last {
                Some((_, before, _)) => value.total_cmp(&before).is_ge(),
                None => value_beside(curve, Place(here), -1).is_some_and(|v| v.total_cmp(&value).is_le()),
            };
            let summit = self.last.filter(|(_, before, rose)| *rose && value.total_cmp(before).is_le());
            self.last = Some((here, value, rose));
            self.summit = summit.map(|(place, ..)| Place(place));
        }
    }
}

/// The tops between two places that may be the highest, each with its place, by what is known of them.
#[derive(Clone, Debug)]
pub struct Rivals {
    from: Place,
    to: Place,
    all: Summits,
    /// Few tops are kept from the search for the highest one. Were there more, they are found again.
    kept: Vec<(Place, Peak), TOPS>,
    fits: bool,
    highest: Option<Peak>,
    least: Option<Least>,
    told: usize,
}

/// What a rival reaches at least.
#[derive(Clone, Copy, Debug)]
struct Least {
    value: f64,
    noise: f64,
}

impl Rivals {
    /// From the first one on.
    pub fn new(curve: &Curve, from: Place, to: Place) -> Self {
        let all = Summits::new(curve, from, to);
        Self { from, to, all, kept: Vec::new(), fits: true, highest: None, least: None, told: 0 }
    }

    /// The next one, if there is one.
    pub fn next(&mut self, curve: &Curve, slice: &mut Slice) -> Poll<Option<(Place, Peak)>> {
        let least = match self.least {
            Some(least) => least,
            None => ready!(self.find_highest(curve, slice)),
        };
        loop {
            let next = if self.fits {
                self.told += 1;
                self.kept.get(self.told - 1).copied()
            } else {
                ready!(self.all.next(curve, slice))
            };
            let Some((place, top)) = next else { return Poll::Ready(None) };
            if top.value + top.error + least.noise >= least.value {
                return Poll::Ready(Some((place, top)));
            }
        }
    }

    fn find_highest(&mut self, curve: &Curve, slice: &mut Slice) -> Poll<Least> {
        while let Some(found) = ready!(self.all.next(curve, slice)) {
            self.fits &= self.kept.push(found).is_ok();
            let top = found.1;
            if self.highest.is_none_or(|highest| top.value > highest.value) {
                self.highest = Some(top);
            }
        }
        if !self.fits {
            self.all = Summits::new(curve, self.from, self.to);
        }
        let value = self.highest.map_or(0.0, |h| h.value - h.error);
        let least = Least { value, noise: 3.0 * curve.noise().relative() * magnitude(value) };
        self.least = Some(least);
        Poll::Ready(least)
    }
}
