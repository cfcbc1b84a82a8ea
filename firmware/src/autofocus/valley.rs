//! The minimum between two lobes: the focus of a phase object.

use super::curve::{Cell, Curve, Place, STRIDE, Side};
use super::peak::{Peak, parabola};
use super::work::Slice;
use core::task::Poll;

/// The minimum between two lobes.
#[derive(Clone, Copy, Debug)]
pub struct Valley {
    /// Its bottom.
    pub bottom: Peak,
    /// How high the lesser lobe is.
    lesser_lobe: f64,
}

impl Valley {
    /// How far the lesser lobe rises above the bottom, relative to the greater one's rise.
    fn depth(&self, top: f64) -> f64 {
        (self.lesser_lobe - self.bottom.value) / (top - self.bottom.value)
    }

    /// Deep enough for the focus of a phase object, if that is what is looked for.
    pub fn is_focus(&self, top: f64) -> bool {
        self.depth(top) > 0.25
    }

    /// Contrast vanishes between two lobes that are both real: an unstained cell, not the two-lobed curve of an edge,
    /// whose minimum stays far above the background.
    pub fn vanishes(&self, top: f64, floor: f64) -> bool {
        self.depth(top) > 0.4
            && self.bottom.value - floor < 0.2 * (top - floor)
            && self.bottom.value < 0.55 * self.lesser_lobe
    }
}

/// What it costs to look at a place, without noise and with it, and to work a bottom out.
const PLACE: i32 = 120;
const NOISY_PLACE: i32 = 600;
const BOTTOM: i32 = 4_000;

/// The search for the deepest minimum between the highest cell and another lobe within the trap radius.
#[derive(Clone, Debug)]
pub struct Deepest {
    top: i32,
    trap: i32,
    deepest: Option<Valley>,
    /// The side that is looked at; `None` when both are done.
    side: Option<Side>,
    /// Distance of the next place from the top.
    next: i32,
    way: Way,
}

/// What was seen on the way out on one side.
#[derive(Clone, Copy, Debug)]
struct Way {
    bottom: f64,
    at: Place,
    depth: f64,
    lobe: f64,
    found: Option<(Place, f64)>,
}

impl Deepest {
    /// Begins at the highest cell; `trap` in places.
    pub fn new(trap: i32, highest: Cell) -> Self {
        let top = highest.x as i32;
        Self { top, trap, deepest: None, side: Some(Side::Low), next: 1, way: Way::new(top) }
    }

    /// Goes on.
    pub fn step(&mut self, curve: &Curve, slice: &mut Slice) -> Poll<Option<Valley>> {
        let silent = curve.noise().is_silent();
        while let Some(side) = self.side {
            let place_costs = if silent { PLACE } else { NOISY_PLACE };
            if !slice.affords(if self.next <= self.trap { place_costs } else { BOTTOM }) {
                return Poll::Pending;
            }
            if self.next <= self.trap {
                let place = Place(self.top + self.next * side.sign());
                self.next += 1;
                if let Some(value) = if silent { curve.mean(place) } else { curve.smooth(place) } {
                    self.way.pass(place, value);
                }
                continue;
            }
            let Way { depth, lobe, found, .. } = self.way;
            if let Some((place, bottom)) = found
                && self.deepest.is_none_or(|d| depth > d.lesser_lobe - d.bottom.value)
            {
                let Some(bottom) = lowest_near(curve, place, bottom) else { return Poll::Ready(None) };
                self.deepest = Some(Valley { bottom, lesser_lobe: lobe });
            }
            (self.next, self.way) = (1, Way::new(self.top));
            self.side = if side == Side::Low { Some(Side::High) } else { None };
        }
        Poll::Ready(self.deepest)
    }
}

impl Way {
    fn new(top: i32) -> Self {
        Self { bottom: f64::MAX, at: Place(top), depth: 0.0, lobe: 0.0, found: None }
    }

    fn pass(&mut self, place: Place, value: f64) {
        // Mostly it goes down, and that is found out without software floats.
        if value.total_cmp(&self.bottom).is_lt() {
            (self.bottom, self.at) = (value, place);
        } else if value - self.bottom > self.depth {
            (self.depth, self.lobe) = (value - self.bottom, value);
            self.found = Some((self.at, self.bottom));
        }
    }
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
    Some(parabola(middle, low, high))
}
