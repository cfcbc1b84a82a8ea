//! The records that DMA plays in a circle, and the guard that makes running dry silent.
//!
//! **The guard.** After the last record there always stand three more: one whose reload value is 0, and two short silent
//! ones. A timer that reaches the first blocks ("The counter is blocked while the auto-reload value is null", RM0090
//! 18.4.12): no update, no request, no pulse, however late the refill comes; nothing is ever played twice. One software
//! update starts it again.
//!
//! **Publishing.** New records are laid behind the guard, whose three slots are replaced last and only while DMA is at least
//! [`MARGIN`] records away from them: it never reads a slot that is being written.

use super::record::{LONGEST, RING, Record};
use core::sync::atomic::{Ordering, compiler_fence};

/// Records that must lie between what DMA fetches next and the guard when the guard is replaced. The FIFO holds one more
/// than was counted, so at least two whole periods (0.52 µs each) are left for the twelve stores.
pub const MARGIN: u32 = 4;

/// Records of the guard.
const GUARD: u32 = 3;

/// Ticks of each of the guard's silent records: what passes between the update that wakes a blocked timer and the next record
/// is twice this.
pub const WAKE: u32 = 84;

/// Slots left free for what a restart puts in front of the records that wait.
const SPARE: u32 = 48;

const MASK: usize = RING - 1;
const _: () = assert!(RING.is_power_of_two());

/// Makes records one after another. Mark `make` as `inline(always)`: it is called at several places of one loop.
pub trait Maker {
    /// The next record.
    fn make(&mut self) -> Record;
}

/// Records are counted from the stream's start; a count wraps at 2³², and its slot is the count modulo [`RING`].
#[derive(Debug)]
#[repr(C)]
pub struct Ring {
    slots: [Record; RING],
    /// The next record to lay.
    head: u32,
    /// The first record of the guard that DMA sees.
    gate: u32,
    /// What the guard's slots get when it is replaced.
    kept: [Record; GUARD as usize],
    /// The next record DMA transfers. The one before the last transferred plays.
    fetched: u32,
}

impl Ring {
    /// An empty ring.
    pub const fn new() -> Self {
        const EMPTY: Record = Record::hold(1, false, 0);
        Self { slots: [EMPTY; RING], head: 0, gate: 0, kept: [EMPTY; GUARD as usize], fetched: 0 }
    }

    /// What DMA is pointed at.
    pub fn slots(&self) -> &[Record; RING] {
        &self.slots
    }

    /// Begins anew from slot 0, nothing laid yet, for a stream that is not running; STEP is at
    /// this level before.
    pub fn clear(&mut self, step_high: bool) {
        (self.head, self.gate, self.fetched) = (0, GUARD.wrapping_neg(), 0);
        // What plays before record 0 has no edge.
        for before in [RING - 2, RING - 1] {
            self.slots[before] = Record::hold(1, step_high, 0);
        }
        self.kept = [Record::hold(1, step_high, 0); GUARD as usize];
    }

    /// How many more records can be laid.
    pub fn room(&self) -> u32 {
        (RING as u32 - SPARE).saturating_sub(self.head.wrapping_sub(self.fetched.wrapping_sub(2)))
    }

    /// The count of the next record to lay.
    pub fn head(&self) -> u32 {
        self.head
    }

    /// Records laid and not fetched.
    pub fn ahead(&self) -> u32 {
        self.head.wrapping_sub(self.fetched)
    }

    /// The record that plays now.
    pub fn playing(&self) -> u32 {
        self.fetched.wrapping_sub(2)
    }

    /// Lays one record. The caller keeps to [`Self::room`].
    #[inline(always)]
    pub fn push(&mut self, record: Record) {
        self.put(self.head, record);
        self.head = self.head.wrapping_add(1);
    }

    /// Lays that many records, made one after another; gives back their maker. The caller keeps to [`Self::room`].
    #[inline(always)]
    pub fn lay<M: Maker>(&mut self, records: u32, mut maker: M) -> M {
        let mut left = records;
        // What belongs into the guard's own slots is kept for later.
        while left > 0 && self.head.wrapping_sub(self.gate) < GUARD {
            self.push(maker.make());
            left -= 1;
        }
        while left > 0 {
            let first = self.head as usize & MASK;
            let last = (first + left as usize).min(RING);
            // Four at a time, written out: the compiler, told to save room, would not.
            let (fours, rest) = self.slots.get_mut(first..last).unwrap_or_default().as_chunks_mut();
            for [a, b, c, d] in fours {
                *a = maker.make();
                *b = maker.make();
                *c = maker.make();
                *d = maker.make();
            }
            for slot in rest {
                *slot = maker.make();
            }
            let laid = (last - first) as u32;
            self.head = self.head.wrapping_add(laid);
            left -= laid;
        }
        maker
    }

    #[inline(always)]
    fn put(&mut self, count: u32, record: Record) {
        let after = count.wrapping_sub(self.gate);
        match self.kept.get_mut(after as usize) {
            Some(kept) => kept.set(&record),
            None => self.slots[count as usize & MASK].set(&record),
        }
    }

    /// A record laid and perhaps played.
    pub fn get(&self, count: u32) -> Record {
        let after = count.wrapping_sub(self.gate) as usize;
        match self.kept.get(after) {
            Some(kept) if self.head != self.gate => *kept,
            _ => self.slots[count as usize & MASK],
        }
    }

    /// A record as DMA sees it.
    pub fn shown(&self, count: u32) -> Record {
        self.slots[count as usize & MASK]
    }

    /// Takes the stream's count of words left in this lap. A record in transfer counts as fetched.
    pub fn seen(&mut self, ndtr: u32) {
        let left = (ndtr / 4) as usize;
        let now = RING.wrapping_sub(left) & MASK;
        let ahead = now.wrapping_sub(self.fetched as usize) & MASK;
        self.fetched = self.fetched.wrapping_add(ahead as u32);
    }

    /// Whether the stream's count of words is as it was last seen.
    pub fn is_at(&self, ndtr: u32) -> bool {
        RING.wrapping_sub((ndtr / 4) as usize) & MASK == self.fetched as usize & MASK
    }

    /// Lays the guard behind the records and puts it in force, unless DMA is too near, or nothing is new.
    pub fn publish(&mut self, step_high: bool, dir: u32, ndtr: impl FnOnce() -> u32) {
        if self.head == self.gate {
            return;
        }
        self.guard(step_high, dir);
        self.seen(ndtr());
        if !self.near() {
            self.open();
        }
    }

    /// As [`Self::publish`], for a stream that is not running.
    pub fn prepare(&mut self, step_high: bool, dir: u32) {
        self.guard(step_high, dir);
        self.open();
    }

    #[inline(always)]
    fn guard(&mut self, step_high: bool, dir: u32) {
        for (i, ticks) in [1, WAKE, WAKE].into_iter().enumerate() {
            self.put(self.head.wrapping_add(i as u32), Record::hold(ticks, step_high, dir));
        }
        compiler_fence(Ordering::SeqCst);
    }

    /// Puts what was kept into the guard's slots, the blocking one last.
    #[inline(always)]
    fn open(&mut self) {
        for i in (0..GUARD).rev() {
            if let Some(kept) = self.kept.get(i as usize) {
                self.slots[self.gate.wrapping_add(i) as usize & MASK].set(kept);
                compiler_fence(Ordering::SeqCst);
            }
        }
        self.gate = self.head;
    }

    /// Whether DMA is too near to the guard to replace it.
    pub fn near(&self) -> bool {
        (self.gate.wrapping_sub(self.fetched) as i32) < MARGIN as i32
    }

    /// Whether the timer stands still at the guard.
    pub fn blocked(&self) -> bool {
        self.fetched == self.gate.wrapping_add(2)
    }

    /// Forgets the records that wait behind the guard.
    pub fn drop_waiting(&mut self) {
        self.head = self.gate;
    }

    /// A blocked timer: puts `wait` ticks of silence before the records that wait, behind the old guard, so that one software
    /// update starts it all: the guard's two silent records first. [`Self::prepare`] must follow.
    pub fn reopen(&mut self, wait: u32, step_high: bool, dir: u32) {
        let gate = self.gate;
        let waiting = if self.head == gate { 0 } else { self.head.wrapping_sub(gate) };
        let pieces = wait.div_ceil(LONGEST).min(SPARE - 2 * GUARD);
        let shift = GUARD + pieces;
        for i in (0..waiting).rev() {
            let record = self.get(gate.wrapping_add(i));
            self.slots[gate.wrapping_add(shift + i) as usize & MASK] = record;
        }
        let mut left = wait;
        for piece in 0..pieces {
            let ticks = left / (pieces - piece);
            left -= ticks;
            self.slots[gate.wrapping_add(GUARD + piece) as usize & MASK] = Record::hold(ticks, step_high, dir);
        }
        for i in 0..GUARD {
            let shown = self.shown(gate.wrapping_add(i));
            if let Some(kept) = self.kept.get_mut(i as usize) {
                *kept = shown;
            }
        }
        self.head = gate.wrapping_add(shift + waiting);
    }
}
