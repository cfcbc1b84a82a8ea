//! The tops of a quiet curve, kept from sample to sample: what lies between the samples costs thousands of instructions
//! to work out, and a new sample changes it only nearby.

use super::curve::{Curve, Place};
use super::peak::{self, Peak};
use super::work::Slice;
use core::task::Poll;
use heapless::Vec;

/// Tops that are kept; were there more, they are worked out again when they are asked for.
const KEPT: usize = 12;

/// A top, and what it was worked out from.
#[derive(Clone, Copy, Debug)]
pub struct Top {
    /// Its place.
    pub place: Place,
    /// The first place that was looked at for it.
    pub from: Place,
    /// The last one.
    pub to: Place,
    /// The top.
    pub peak: Peak,
}

/// The tops that are known.
#[derive(Clone, Debug, Default)]
pub struct Tops(Vec<Top, KEPT>);

impl Tops {
    /// The top at a place, if it is kept.
    pub fn at(&self, place: Place) -> Option<Peak> {
        self.0.iter().find(|top| top.place == place).map(|top| top.peak)
    }

    /// Forgets what was worked out from a place.
    pub fn changed(&mut self, place: Place) {
        self.0.retain(|top| place < top.from || place > top.to);
    }

    fn keep(&mut self, top: Top) {
        if self.0.is_full() {
            let away = |t: &Top| (t.place.0 - top.place.0).abs();
            if let Some((farthest, _)) = self.0.iter().enumerate().max_by_key(|(_, t)| away(t)) {
                self.0.swap_remove(farthest);
            }
        }
        // It was made room for.
        let _ = self.0.push(top);
    }
}

/// What it costs to work a top out.
const WORKED_OUT: i32 = 8_000;

/// Works out the tops that a new sample at a place made or changed; `done` of the places around it are settled already, and in
/// the end so many.
pub fn update(curve: &mut Curve, place: Place, mut done: usize, slice: &mut Slice) -> (usize, Poll<()>) {
    // A top depends on two known places to each side.
    let (low, high) = (peak::near(curve, place, -1), peak::near(curve, place, 1));
    let (lower, higher) = (low.and_then(|p| peak::near(curve, p, -1)), high.and_then(|p| peak::near(curve, p, 1)));
    for place in [lower, low, Some(place), high, higher].into_iter().skip(done) {
        if let Some(place) = place
            && peak::is_top(curve, place)
            && curve.tops().at(place).is_none()
        {
            if !slice.affords(WORKED_OUT) {
                return (done, Poll::Pending);
            }
            if let Some(top) = peak::work_out(curve, place) {
                curve.tops_mut().keep(top);
            }
        }
        done += 1;
    }
    (done, Poll::Ready(()))
}
