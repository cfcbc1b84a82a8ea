//! An axis' phases as a sequence of edges.

use super::phase::{Phase, Place, Span};
use super::swing::Quarter;
use heapless::Deque;

/// Phases an axis holds, those over and those to come.
pub const PHASES: usize = 14;

/// An edge to come.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    pub tick: u64,
    /// Towards larger counts.
    pub up: bool,
}

/// Edges in the order of time: generated span by span, with up to two looked at ahead.
#[derive(Debug)]
pub(super) struct Edges {
    phases: Deque<Phase, PHASES>,
    /// Phases generated whole, at the front of `phases`.
    done: usize,
    place: Option<Place>,
    /// What is left of the span that is being generated.
    pub span: Span,
    ahead: [Option<Edge>; 2],
}

impl Edges {
    pub const fn new() -> Self {
        Self {
            phases: Deque::new(),
            done: 0,
            place: None,
            span: Span { left: 0, time: 0, by: [0; 3], up: false },
            ahead: [None; 2],
        }
    }

    /// Whether there are none left.
    pub fn exhausted(&self) -> bool {
        self.done >= self.phases.len() && self.place.is_none() && self.ahead[0].is_none()
    }

    /// Whether the span goes on with the next edge: nothing was looked at ahead.
    #[inline(always)]
    pub fn in_span(&self) -> bool {
        self.span.left > 1 && self.ahead[0].is_none()
    }

    /// Adds a phase. False when there is no room.
    pub fn append(&mut self, phase: Phase) -> bool {
        if self.phases.is_full() && self.done > 0 {
            self.phases.pop_front();
            self.done -= 1;
        }
        self.phases.push_back(phase).is_ok()
    }

    /// How many phases [`Self::append`] takes.
    pub fn space(&self) -> usize {
        PHASES - self.phases.len() + self.done
    }

    /// Drops everything.
    pub fn clear(&mut self) {
        self.phases.clear();
        self.done = 0;
        self.drop_generated();
    }

    fn drop_generated(&mut self) {
        self.place = None;
        self.span.left = 0;
        self.ahead = [None; 2];
    }

    /// Cuts the path: of the phase that spans `tick`, `steps` edges remain, of later ones none. False, and nothing changed,
    /// when more than that were taken already. `now` is a tick before which all edges were taken.
    pub fn cut(&mut self, tick: u64, steps: u32, now: u64) -> bool {
        let spans = |p: &Phase| p.begin.saturating_add(p.ticks) > tick;
        let Some((at, phase)) = self.phases.iter().enumerate().find(|(_, p)| spans(p)) else { return true };
        let steps = if phase.begin >= tick { 0 } else { steps };
        if !self.rewind(at, steps, now) {
            return false;
        }
        while self.phases.len() > at + 1 {
            self.phases.pop_back();
        }
        if let Some(phase) = self.phases.back_mut() {
            phase.cut(steps);
            phase.ticks = tick.saturating_sub(phase.begin);
        }
        true
    }

    /// Takes back edges looked at; false when phase `at` has more than `steps` taken.
    fn rewind(&mut self, at: usize, steps: u32, now: u64) -> bool {
        let waiting = self.ahead.iter().flatten().count() as u32;
        // What is left of the span is not generated.
        let mut index = self.place.map_or(0, |p| p.index.wrapping_sub(self.span.left));
        let mut phase = self.done;
        let tick = self.ahead[0].map_or(now, |e| e.tick);
        for _ in 0..waiting {
            while index == 0 && phase > 0 {
                phase -= 1;
                index = self.phases.iter().nth(phase).map_or(0, |p| p.steps);
            }
            index = index.wrapping_sub(1);
        }
        if phase > at || (phase == at && index > steps) {
            return false;
        }
        let Some(p) = self.phases.iter().nth(phase) else { return false };
        let place = if index == 0 { p.place() } else { p.seek(index, tick.max(p.begin)) };
        self.drop_generated();
        self.done = phase;
        self.place = Some(place);
        true
    }

    /// The next edge, or the one after it; `near` is a tick within 25 s before it.
    pub fn peek(&mut self, which: usize, near: u64, table: &Quarter) -> Option<Edge> {
        for i in 0..=which {
            if self.ahead.get(i)?.is_none() {
                let edge = self.generate(near, table)?;
                *self.ahead.get_mut(i)? = Some(edge);
            }
        }
        *self.ahead.get(which)?
    }

    /// Takes the edge that [`Self::peek`] gave first.
    pub fn take(&mut self) {
        self.ahead = [self.ahead[1], None];
    }

    fn generate(&mut self, near: u64, table: &Quarter) -> Option<Edge> {
        while self.span.left == 0 {
            let (a, b) = self.phases.as_slices();
            let phase = a.get(self.done).or_else(|| b.get(self.done.wrapping_sub(a.len())))?;
            let mut place = self.place.unwrap_or_else(|| phase.place());
            if place.index >= phase.steps {
                self.place = None;
                self.done += 1;
                continue;
            }
            self.span = phase.span(&mut place, table);
            self.place = Some(place);
        }
        let after = ((self.span.time >> 32) as u32).wrapping_sub(near as u32) as i32;
        let [d1, d2, d3] = self.span.by;
        self.span.time = self.span.time.wrapping_add_signed(d1);
        self.span.by = [d1.wrapping_add(d2), d2.wrapping_add(d3), d3];
        self.span.left -= 1;
        Some(Edge { tick: near.saturating_add_signed(i64::from(after)), up: self.span.up })
    }
}
