//! What a scan has seen: the focus curve, in bounded memory, and running sums that outlive it.

use super::exact::{added, divided};
use super::noise::{Noise, Trend};
pub use super::places::{Cell, Level, Place, Side};
use super::tops::{self, Tops};
use super::work::Slice;
use core::task::Poll;
use parfocal_protocol::units::{FocusValue, Nanometres};

/// Places that a curve keeps; the oldest on the same slot is forgotten.
pub const CELLS: usize = 512;

/// Places in a sample step: the way back may sample between the places of the way out.
pub const STRIDE: i32 = 2;

/// Sample steps over which the level at an end of the curve is averaged.
const END: i32 = 8;

/// Frames within this part of a place of each other show the same.
const SAME: f64 = 0.05;

#[derive(Clone, Copy, Debug)]
struct Slot {
    mean: f64,
    off: f32,
    place: i16,
    frames: u16,
}

#[derive(Clone, Copy, Debug, Default)]
struct Bin {
    mean: f32,
    frames: u16,
}

/// The focus curve on a grid through the start.
#[derive(Clone, Debug)]
pub struct Curve {
    origin: i32,
    unit: i32,
    first: i32,
    last: i32,
    seen: [i32; 2],
    ends: [Level; 2],
    frames: u32,
    travelled: i64,
    here: i32,
    reference: f64,
    floor: f64,
    best: Option<(Place, f64)>,
    noise: Noise,
    trend: Trend,
    rest: Trend,
    revisits: Level,
    tops: Tops,
    /// The latest frame's place, and how many of the places around it are settled.
    unsettled: Option<(Place, usize)>,
    slots: [Slot; CELLS],
    bins: [Bin; Curve::BINS],
}

impl Curve {
    /// Bins of the coarse curve over the whole range.
    pub const BINS: usize = 128;

    /// An empty curve from `low` to `high`, whose grid goes through `origin`; `step` is at least [`STRIDE`] nm.
    pub fn new(origin: Nanometres, low: Nanometres, high: Nanometres, step: Nanometres) -> Self {
        Self {
            origin: origin.0,
            unit: step.0 / STRIDE,
            first: (low.0 - origin.0) / step.0 * STRIDE,
            last: (high.0 - origin.0) / step.0 * STRIDE,
            seen: [0; 2],
            ends: [Level::default(); 2],
            frames: 0,
            travelled: 0,
            here: 0,
            reference: 0.0,
            floor: f64::MAX,
            best: None,
            noise: Noise::default(),
            trend: Trend::default(),
            rest: Trend::default(),
            revisits: Level::default(),
            tops: Tops::default(),
            unsettled: None,
            slots: [Slot { mean: 0.0, off: 0.0, place: 0, frames: 0 }; CELLS],
            bins: [Bin::default(); Self::BINS],
        }
    }

    /// The end of the range on one side.
    pub fn limit(&self, side: Side) -> Place {
        Place(if side == Side::Low { self.first } else { self.last })
    }

    /// The farthest place that was visited on one side.
    pub fn seen(&self, side: Side) -> Place {
        Place(self.seen[side as usize])
    }

    /// The level at the farthest place visited on one side; over a few steps if there is noise.
    pub fn end(&self, side: Side) -> Level {
        self.ends[side as usize]
    }

    /// Places not visited yet on one side.
    pub fn ahead(&self, side: Side) -> i32 {
        (self.limit(side).0 - self.seen(side).0) * side.sign()
    }

    /// Frames taken.
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// Sample steps travelled between frames.
    pub fn travelled(&self) -> i64 {
        self.travelled / i64::from(STRIDE)
    }

    /// The place of the latest frame.
    pub fn here(&self) -> Place {
        Place(self.here)
    }

    /// The first value.
    pub fn reference(&self) -> f64 {
        self.reference
    }

    /// The lowest level that an end of the seen part ever had.
    pub fn floor(&self) -> f64 {
        self.floor
    }

    /// The highest place so far, smoothed over its neighbours if there is noise.
    pub fn best(&self) -> Option<(Place, f64)> {
        self.best
    }

    /// Noise of one frame.
    pub fn noise(&self) -> &Noise {
        &self.noise
    }

    /// The line through everything seen.
    pub fn trend(&self) -> &Trend {
        &self.trend
    }

    /// The line through the frames at the start, by their number: light that drifts shows.
    pub fn rest(&self) -> &Trend {
        &self.rest
    }

    /// By how much the places that were visited again had changed, relative to their value: mean and count.
    pub fn revisits(&self) -> Level {
        self.revisits
    }

    /// Where a place lies.
    pub fn position(&self, place: Place) -> Nanometres {
        Nanometres(self.origin + place.0 * self.unit)
    }

    /// Where a fraction of a place lies.
    pub fn exactly(&self, at: f64) -> Nanometres {
        let nm = at * f64::from(self.unit);
        Nanometres(self.origin + (if nm < 0.0 { nm - 0.5 } else { nm + 0.5 }) as i32)
    }

    /// The place nearest to a position, within the range.
    pub fn place(&self, z: Nanometres) -> Place {
        let off = z.0.saturating_sub(self.origin);
        let half = if off < 0 { -self.unit / 2 } else { self.unit / 2 };
        Place((off.saturating_add(half) / self.unit).clamp(self.first, self.last))
    }

    /// A length in whole places, rounded up to full sample steps.
    pub fn places(&self, length: Nanometres) -> i32 {
        let step = self.unit * STRIDE;
        length.0.saturating_add(step - 1) / step * STRIDE
    }

    /// Marks the way to `z` as visited, without a frame: a sweep's leg ended there.
    pub fn visit(&mut self, z: Nanometres) {
        let place = self.place(z).0;
        self.seen = [self.seen[0].min(place), self.seen[1].max(place)];
    }

    /// Takes in one frame from the start, before anything moved: such frames show whether the light drifts. One of a sweep that
    /// has begun does not: however near, it lies on the slope, and by how much is as uncertain as its time.
    pub fn add_at_rest(&mut self, z: Nanometres, value: FocusValue) {
        let reference = if self.frames == 0 { value.0 } else { self.reference };
        self.rest.add(f64::from(self.frames), value.0 - reference);
        self.add(z, value);
    }

    /// Takes in one frame.
    pub fn add(&mut self, z: Nanometres, value: FocusValue) {
        let value = value.0;
        let place = self.place(z).0;
        let off = z.0.saturating_sub(self.position(Place(place)).0) as f32 / self.unit as f32;
        if self.frames == 0 {
            self.reference = value;
        }
        self.frames += 1;
        self.travelled += i64::from((place - self.here).abs());
        let way = z.0.saturating_sub(self.origin);
        // On the grid the quotient is whole, and costs no software division.
        let x = if off == 0.0 { f64::from(place) } else { divided(f64::from(way), f64::from(self.unit)) };
        self.trend.add(x, value - self.reference);
        let moved = place != self.here;
        self.here = place;

        let slot = &mut self.slots[index(place)];
        self.tops.changed(Place(i32::from(slot.place)));
        self.tops.changed(Place(place));
        if slot.frames == 0 || i32::from(slot.place) != place {
            *slot = Slot { mean: value, off, place: place as i16, frames: 1 };
        } else {
            let before = slot.mean;
            let scale = magnitude(before);
            // In a sweep the next frame lies a little further on the slope: no noise, either.
            let again = magnitude(f64::from(off - slot.off)) < SAME;
            slot.frames = slot.frames.saturating_add(1);
            slot.mean += (value - slot.mean) / f64::from(slot.frames);
            slot.off += (off - slot.off) / f32::from(slot.frames);
            if moved && scale > 0.0 {
                // A return: tells of drifting light, not of noise.
                self.revisits.frames += 1;
                self.revisits.mean += ((value - before) / scale - self.revisits.mean) / f64::from(self.revisits.frames);
            } else if again {
                let after = slot.mean;
                self.noise.add(value, before, after, scale);
            }
        }
        self.visit(z);
        self.sum_up(place, value);
        self.unsettled = self.noise.is_silent().then_some((Place(place), 0));
    }

    /// Works out the tops that the latest frame made or changed, so that no later decision has to do it for many at once.
    pub(super) fn settle(&mut self, slice: &mut Slice) -> Poll<()> {
        let Some((place, done)) = self.unsettled else { return Poll::Ready(()) };
        let (done, settled) = tops::update(self, place, done, slice);
        self.unsettled = settled.is_pending().then_some((place, done));
        settled
    }

    /// The tops that are kept.
    pub(super) fn tops(&self) -> &Tops {
        &self.tops
    }

    /// The same, to be kept up to date.
    pub(super) fn tops_mut(&mut self) -> &mut Tops {
        &mut self.tops
    }

    /// What is known of a place; `None` where no frame was taken or where it was forgotten.
    pub fn at(&self, place: Place) -> Option<Cell> {
        self.slot(place).map(|slot| Cell {
            x: if slot.off == 0.0 { f64::from(place.0) } else { added(f64::from(place.0), f64::from(slot.off)) },
            place,
            off: slot.off,
            frames: slot.frames,
            mean: slot.mean,
        })
    }

    fn slot(&self, place: Place) -> Option<&Slot> {
        let slot = &self.slots[index(place.0)];
        (slot.frames > 0 && i32::from(slot.place) == place.0).then_some(slot)
    }

    /// The mean value at a place, as of [`Curve::at`]; to compare values, which needs no position.
    pub fn mean(&self, place: Place) -> Option<f64> {
        self.slot(place).map(|slot| slot.mean)
    }

    /// The known places from `from` to `to`.
    pub fn between(&self, from: Place, to: Place) -> impl Iterator<Item = (Place, Cell)> + '_ {
        (from.0..=to.0).map(Place).filter_map(|p| self.at(p).map(|c| (p, c)))
    }

    /// Mean level of the known places from `from` to `to`.
    pub fn level(&self, from: Place, to: Place) -> Level {
        let (mut sum, mut frames) = (0.0, 0);
        for slot in (from.0..=to.0).filter_map(|p| self.slot(Place(p))) {
            sum += slot.mean * f64::from(slot.frames);
            frames += u32::from(slot.frames);
        }
        Level { mean: if frames > 0 { sum / f64::from(frames) } else { 0.0 }, frames }
    }

    /// The mean of a place and its neighbours a step away, weighted 1 : 2 : 1.
    pub fn smooth(&self, place: Place) -> Option<f64> {
        let middle = self.mean(place)?;
        let side = |p: i32| self.mean(Place(p)).unwrap_or(middle);
        Some(0.25 * (side(place.0 - STRIDE) + 2.0 * middle + side(place.0 + STRIDE)))
    }

    /// The variance of [`Curve::smooth`] at a place, if that of one frame is 1.
    pub fn smooth_variance(&self, place: Place) -> f64 {
        let (mut own, mut variance) = (0.5, 0.0);
        for side in [-STRIDE, STRIDE] {
            match self.at(Place(place.0 + side)) {
                Some(cell) => variance += 0.0625 / f64::from(cell.frames),
                None => own += 0.25,
            }
        }
        self.at(place).map_or(1.0, |cell| variance + own * own / f64::from(cell.frames))
    }

    /// The coarse curve: the middle of bin `i` of [`Curve::BINS`], and the mean of its frames less the first value.
    pub fn bin(&self, i: i32) -> Option<(Place, f32)> {
        let bin = self.bins.get(usize::try_from(i).ok()?).filter(|b| b.frames > 0)?;
        let width = self.bin_width();
        Some((Place(self.first + i * width + width / 2), bin.mean))
    }

    /// Places that a bin spans.
    pub fn bin_width(&self) -> i32 {
        (self.last - self.first) / Self::BINS as i32 + 1
    }

    /// Keeps what must outlive the slots.
    fn sum_up(&mut self, place: i32, value: f64) {
        let width = self.bin_width();
        let bin = &mut self.bins[((place - self.first) / width) as usize];
        bin.frames = bin.frames.saturating_add(1);
        bin.mean += ((value - self.reference) as f32 - bin.mean) / f32::from(bin.frames);

        let quiet = self.noise.is_silent();
        for side in [Side::Low, Side::High] {
            if place == self.seen(side).0 {
                let inner = place - side.sign() * (END - 1) * STRIDE;
                let level = match self.slot(Place(place)).filter(|_| quiet) {
                    // A mean of equal values may differ from them by a rounding: silence must stay exact.
                    Some(slot) => Level { mean: slot.mean, frames: u32::from(slot.frames) },
                    None => self.level(Place(place.min(inner)), Place(place.max(inner))),
                };
                self.ends[side as usize] = level;
                if level.mean < self.floor {
                    self.floor = level.mean;
                }
            }
        }

        let reach = if quiet { 0 } else { STRIDE };
        for p in (place - reach..=place + reach).map(Place) {
            let smooth = if quiet { self.mean(p) } else { self.smooth(p) };
            if let Some(v) = smooth
                && self.best.is_none_or(|(q, b)| q == p || v > b)
            {
                self.best = Some((p, v));
            }
        }
    }
}

/// |x|, without software floats.
pub fn magnitude(x: f64) -> f64 {
    f64::from_bits(x.to_bits() & !(1 << 63))
}

fn index(place: i32) -> usize {
    place.rem_euclid(CELLS as i32) as usize
}
