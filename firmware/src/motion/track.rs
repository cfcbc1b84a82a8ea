//! One axis: its phases become edges, its edges become records.

use super::edges::Edges;
use super::marks::{Mark, Marks};
use super::phase::Phase;
use super::record::{LONGEST, Pulse, Record, SHORTEST};
use super::ring::Ring;
use super::swing::Quarter;

/// Records that are always laid ahead, however long they are: the guard must not come near.
const FEWEST: u32 = 14;

/// One axis.
#[derive(Debug)]
pub struct Track {
    /// Its records.
    pub ring: Ring,
    /// Tick at which the next record begins.
    pub end: u64,
    /// Steps of all records laid.
    pub issued: i32,
    /// Count of the last record that holds an edge.
    last_edge: u32,
    marks: Marks,
    pub(super) pulse: Pulse,
    pub(super) edges: Edges,
    /// Whether STEP changes as the next record begins.
    open: bool,
    high: bool,
    pub(super) dir: u32,
    dir_up: bool,
}

impl Track {
    /// At rest, STEP low.
    #[allow(clippy::new_without_default, reason = "const, for a static")]
    pub const fn new() -> Self {
        Self {
            ring: Ring::new(),
            end: 0,
            issued: 0,
            last_edge: 0,
            marks: Marks::new(),
            pulse: Pulse { high: 420, setup: 420, both: false, inverted: false },
            edges: Edges::new(),
            open: false,
            high: false,
            dir: 0,
            dir_up: false,
        }
    }

    /// Begins anew at `tick` on a stream that is not running: silence of `ticks`, then the guard.
    pub fn prepare(&mut self, tick: u64, ticks: u32) {
        self.edges.clear();
        self.open = false;
        self.ring.clear(self.high);
        self.end = tick;
        self.marks.restart(self.here());
        for _ in 0..ticks / LONGEST {
            self.piece(LONGEST);
        }
        self.last_edge = 8u32.wrapping_neg();
        self.close();
    }

    /// Sets how pulses look; for an axis at rest.
    pub fn set_pulse(&mut self, pulse: Pulse) {
        self.pulse = pulse;
        self.high &= pulse.both;
        self.dir_up = self.dir != Record::dir(pulse.inverted);
    }

    /// STEP's level and DIR's compare value behind the last record.
    pub fn levels(&self) -> (bool, u32) {
        (self.high, self.dir)
    }

    /// Declares the count of steps; for an axis at rest.
    pub fn set_steps(&mut self, steps: i32) {
        self.issued = steps;
        self.marks.restart(self.here());
    }

    /// Whether there is nothing left to lay.
    pub fn exhausted(&self) -> bool {
        self.edges.exhausted() && !self.open
    }

    /// Whether the last edge is out, as DMA was last seen.
    pub fn out(&self) -> bool {
        (self.ring.playing().wrapping_sub(self.last_edge) as i32) > 0
    }

    /// The nearest place behind a record at which the count is known, and how many records lie between.
    #[inline(always)]
    fn known_from(&self, record: u32) -> (Mark, u32) {
        let here = self.here();
        if (here.record.wrapping_sub(record) as i32) <= 0 {
            return (here, 0);
        }
        let mark = self.marks.from(record, here);
        (mark, mark.record.wrapping_sub(record))
    }

    /// The first record of which nothing is played, and whether the one before plays.
    fn unplayed(&self) -> (u32, bool) {
        let (playing, blocked) = (self.ring.playing(), self.ring.blocked());
        let next = if blocked { playing } else { playing.wrapping_add(1) };
        (next, !blocked && (self.ring.head().wrapping_sub(next) as i32) >= 0)
    }

    /// Tick at which the record that plays began, as DMA was last seen; at the guard, where what was laid before it is played.
    pub fn reached(&self) -> u64 {
        let (next, plays) = self.unplayed();
        let (mark, between) = self.known_from(next);
        let mut tick = self.end.wrapping_sub(u64::from((self.end as u32).wrapping_sub(mark.tick)));
        let from = if plays { next.wrapping_sub(1) } else { next };
        for i in 0..between + u32::from(plays) {
            tick -= u64::from(self.ring.get(from.wrapping_add(i)).ticks());
        }
        tick
    }

    /// Steps behind the outputs, as DMA was last seen; `count` is the timer's, without which every edge of the record that plays
    /// counts as out.
    pub fn played(&self, count: Option<u32>) -> i32 {
        let (next, plays) = self.unplayed();
        let (mark, between) = self.known_from(next);
        let mut steps = mark.steps;
        let mut was_high =
            if self.ring.blocked() { self.high_at_gate(next) } else { self.ring.get(next.wrapping_sub(1)).ends_high() };
        for i in 0..between {
            let record = self.ring.get(next.wrapping_add(i));
            steps = steps.wrapping_sub(self.steps_of(&record, was_high));
            was_high = record.ends_high();
        }
        if let Some(count) = count.filter(|_| plays && self.pulse.both) {
            let record = self.ring.get(next.wrapping_sub(1));
            if record.starts_high() && !record.ends_high() && count < record.ccr1 {
                steps = steps.wrapping_sub(self.sign(&record));
            }
        }
        steps
    }

    /// Whether the record that plays is a long one.
    pub fn plays_long(&self) -> bool {
        !self.ring.blocked() && self.ring.get(self.ring.playing()).ticks() >= 1_000
    }

    /// The timer stands at the guard: puts silence before what waits, as long as this axis is ahead of `first`.
    /// [`Self::close`] must follow.
    pub fn reopen(&mut self, first: u64) {
        let gate = self.ring.playing();
        let shown = self.ring.shown(gate);
        let wait = self.reached().saturating_sub(first) as u32;
        // Too short a wait for a record joins a longer one: every axis gets the same on top.
        self.ring.reopen(wait + LONGEST, shown.starts_high(), shown.ccr2);
        self.marks.restart(self.here());
    }

    /// The timer stands at the guard: what waits behind it is not played any more.
    pub fn abandon(&mut self) {
        let (steps, tick) = (self.played(None), self.reached());
        let shown = self.ring.shown(self.ring.playing());
        self.edges.clear();
        self.ring.drop_waiting();
        (self.issued, self.end, self.open) = (steps, tick, false);
        (self.high, self.dir) = (shown.starts_high(), shown.ccr2);
        self.dir_up = (self.dir != 0) != self.pulse.inverted;
        self.last_edge = self.ring.playing().wrapping_sub(1);
        self.marks.restart(self.here());
    }

    /// Puts the guard behind what is laid, for a timer that stands or a stream that is not running.
    pub fn close(&mut self) {
        self.ring.prepare(self.high, self.dir);
    }

    /// Timer and stream stopped: counts what was played, and forgets the rest.
    pub fn halt(&mut self, left: u32, count: u32) {
        self.ring.seen(left);
        let (_, plays) = self.unplayed();
        let (steps, tick) = (self.played(Some(count)), self.reached() + if plays { u64::from(count) } else { 0 });
        let record = self.ring.shown(self.ring.playing());
        // In both-edge stepping a change of level is a step: the level stays.
        self.high = self.pulse.both && count < record.ccr1;
        self.dir = record.ccr2;
        self.dir_up = (self.dir != 0) != self.pulse.inverted;
        self.issued = steps;
        self.end = tick;
        self.open = false;
        self.edges.clear();
        self.ring.clear(self.high);
        self.last_edge = 8u32.wrapping_neg();
        self.marks.restart(self.here());
    }

    /// STEP's level while the timer stands at the guard.
    fn high_at_gate(&self, gate: u32) -> bool {
        self.ring.shown(gate).starts_high()
    }

    fn sign(&self, record: &Record) -> i32 {
        if (record.ccr2 != 0) != self.pulse.inverted { 1 } else { -1 }
    }

    /// Steps that a record makes, signed.
    pub fn steps_of(&self, record: &Record, was_high: bool) -> i32 {
        let rise = record.starts_high();
        let edges = if self.pulse.both {
            i32::from(rise != was_high) + i32::from(rise && !record.ends_high())
        } else {
            i32::from(rise)
        };
        edges * self.sign(record)
    }

    /// Once the last edge is out, keeps its count from falling behind by half the range of counts.
    pub fn rest(&mut self) {
        if self.out() {
            self.last_edge = self.ring.playing().wrapping_sub(1);
        }
    }

    /// Whether a path has begun and its last edge is not out.
    pub fn under_way(&self) -> bool {
        self.open || !self.out() || self.edges.begun(self.end)
    }

    /// Whether DIR or STEP changes level, or may, from here on.
    pub fn busy(&self) -> bool {
        !self.exhausted() || !self.out()
    }

    /// Adds phases. False when they do not all fit, and then none is added.
    pub fn append(&mut self, phases: &[Phase]) -> bool {
        self.edges.space() >= phases.len() && phases.iter().all(|p| self.edges.append(*p))
    }

    /// Cuts the path at a tick not laid yet: of the phase there, `steps` edges remain. False when more are laid.
    pub fn cut(&mut self, tick: u64, steps: u32) -> bool {
        self.end <= tick && self.edges.cut(tick, steps, self.end)
    }

    /// Whether [`Self::cut`] would cut.
    pub fn can_cut(&self, tick: u64, steps: u32) -> bool {
        self.end <= tick && self.edges.can_cut(tick, steps)
    }

    /// Lays records until they reach `horizon` or there is no room.
    pub fn fill(&mut self, horizon: u64, table: &Quarter) {
        let mut room = self.ring.room();
        if self.exhausted() {
            // At rest, as most axes are most of the time: silence, without looking for edges.
            while (self.end < horizon || self.ring.ahead() < FEWEST) && room > 0 {
                self.ring.push(Record::hold(LONGEST, self.high, self.dir));
                self.end += u64::from(LONGEST);
                room -= 1;
            }
        }
        while (self.end < horizon || self.ring.ahead() < FEWEST) && room > 0 {
            let low = !(self.pulse.both && self.high);
            if self.open && low && self.edges.in_span(table) && self.edges.span.up == self.dir_up {
                let ran = self.run(horizon, room);
                if ran > 0 {
                    room -= ran;
                    continue;
                }
            }
            room -= self.lay_next(table).min(room);
        }
        self.mark();
    }

    fn here(&self) -> Mark {
        Mark { record: self.ring.head(), steps: self.issued, tick: self.end as u32 }
    }

    /// Remembers what was laid up to here.
    pub(super) fn mark(&mut self) {
        self.marks.note(self.here());
    }

    /// Counts steps laid, the latest in the last record.
    pub(super) fn count(&mut self, steps: i32) {
        self.issued = self.issued.wrapping_add(if self.dir_up { steps } else { -steps });
        self.last_edge = self.ring.head().wrapping_sub(1);
    }

    /// Lays the next record or two, however far the next edge is.
    fn lay_next(&mut self, table: &Quarter) -> u32 {
        let Some(edge) = self.edges.peek(0, self.end, table) else {
            // Nothing to do: silence, or the end of the last pulse.
            self.piece(LONGEST);
            return 1;
        };
        if edge.up != self.dir_up {
            let setup = self.pulse.setup.max(SHORTEST);
            let turn = edge.tick.saturating_sub(u64::from(setup));
            // DIR stands as long after a step as before one.
            let hold = if self.open { u64::from(self.pulse.high + self.pulse.setup) } else { 0 };
            if turn.max(self.end + hold) > self.end {
                self.towards(turn.max(self.end + hold));
                return 1;
            }
            // The planner leaves room for DIR at every reversal; were there none, the step would come later, never wrongly.
            self.dir_up = edge.up;
            self.dir = Record::dir(edge.up != self.pulse.inverted);
            self.piece(setup);
            return 1;
        }
        if edge.tick <= self.end && !self.open {
            self.edges.take();
            self.open = true;
            return 0;
        }
        if self.open && self.pulse.both && !self.high {
            let second = self
                .edges
                .peek(1, self.end, table)
                .filter(|e| e.up == edge.up && e.tick.wrapping_sub(self.end) <= u64::from(LONGEST));
            if let Some(second) = second {
                self.edges.take();
                self.edges.take();
                self.lay(second.tick.wrapping_sub(self.end) as u32, edge.tick.wrapping_sub(self.end) as u32);
                self.count(2);
                // The second edge opens the next record.
                self.open = true;
                return 1;
            }
        }
        self.towards(edge.tick);
        1
    }

    /// One record towards a tick at which something happens.
    fn towards(&mut self, tick: u64) {
        // Nothing is planned so near; if it were, it would come later and not block the timer.
        let wait = tick.saturating_sub(self.end).max(u64::from(SHORTEST));
        let longest = u64::from(LONGEST);
        let ticks = if wait <= longest {
            wait
        } else if wait < 2 * longest {
            wait / 2
        } else {
            longest
        };
        self.piece(ticks as u32);
    }

    /// A record without a further edge: the level that STEP has, or gets if an edge opens it.
    fn piece(&mut self, ticks: u32) {
        let opened = core::mem::take(&mut self.open);
        let high = match (opened, self.pulse.both) {
            (true, false) => self.pulse.high,
            (true, true) => {
                self.high = !self.high;
                Record::hold(1, self.high, 0).ccr1
            }
            (false, _) => Record::hold(1, self.high, 0).ccr1,
        };
        self.lay(ticks, high);
        if opened {
            self.count(1);
        }
    }

    fn lay(&mut self, ticks: u32, high: u32) {
        self.ring.push(Record::pulse(ticks, high, self.dir));
        self.end += u64::from(ticks);
    }
}
