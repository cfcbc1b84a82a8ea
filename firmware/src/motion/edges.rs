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

    /// Whether a path that has edges left began before a tick.
    pub fn begun(&self, tick: u64) -> bool {
        !self.exhausted() && self.phases.iter().nth(self.done).is_none_or(|p| p.begin < tick)
    }

    /// Whether the next edges are those of `span`: nothing was looked at ahead.
    #[inline(always)]
    pub fn in_span(&mut self, table: &Quarter) -> bool {
        self.ahead[0].is_none() && (self.span.left > 0 || self.next_span(table))
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
        let Some((at, steps)) = self.spanning(tick, steps) else { return true };
        if !self.can_cut(tick, steps) {
            return false;
        }
        let (phase, index) = self.untaken(at);
        let near = self.ahead[0].map_or(now, |e| e.tick);
        let Some(p) = self.phases.iter().nth(phase) else { return false };
        let place = if index == 0 { p.place() } else { p.seek(index, near.max(p.begin)) };
        self.drop_generated();
        self.done = phase;
        self.place = Some(place);
        while self.phases.len() > at + 1 {
            self.phases.pop_back();
        }
        if let Some(phase) = self.phases.back_mut() {
            phase.cut(steps);
            phase.ticks = tick.saturating_sub(phase.begin);
        }
        true
    }

    /// Whether [`Self::cut`] would cut.
    pub fn can_cut(&self, tick: u64, steps: u32) -> bool {
        let Some((at, steps)) = self.spanning(tick, steps) else { return true };
        let (phase, index) = self.untaken(at);
        phase < at || (phase == at && index <= steps)
    }

    /// The phase that spans a tick, or the first behind it, and how many of its edges remain.
    fn spanning(&self, tick: u64, steps: u32) -> Option<(usize, u32)> {
        let mut phases = self.phases.iter().enumerate();
        let (at, phase) = phases.find(|(_, p)| p.begin.saturating_add(p.ticks) > tick)?;
        Some((at, if phase.begin >= tick { 0 } else { steps }))
    }

    /// The first edge that was not taken, looked at or not: phase and index. The end of a phase counts as the beginning of the
    /// next, except that of phase `at`.
    fn untaken(&self, at: usize) -> (usize, u32) {
        let steps = |phase: usize| self.phases.iter().nth(phase).map_or(0, |p| p.steps);
        // What is left of the span is not generated.
        let mut index = self.place.map_or(0, |p| p.index.wrapping_sub(self.span.left));
        let mut phase = self.done;
        for _ in 0..self.ahead.iter().flatten().count() {
            while index == 0 && phase > 0 {
                phase -= 1;
                index = steps(phase);
            }
            index = index.wrapping_sub(1);
        }
        while index == 0 && phase > at {
            phase -= 1;
            index = steps(phase);
        }
        (phase, index)
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

    /// Goes on to the next span; false when there is none.
    fn next_span(&mut self, table: &Quarter) -> bool {
        while self.span.left == 0 {
            let (a, b) = self.phases.as_slices();
            let phase = a.get(self.done).or_else(|| b.get(self.done.wrapping_sub(a.len())));
            let Some(phase) = phase else { return false };
            let mut place = self.place.unwrap_or_else(|| phase.place());
            if place.index >= phase.steps {
                self.place = None;
                self.done += 1;
                continue;
            }
            self.span = phase.span(&mut place, table);
            self.place = Some(place);
        }
        true
    }

    fn generate(&mut self, near: u64, table: &Quarter) -> Option<Edge> {
        if self.span.left == 0 && !self.next_span(table) {
            return None;
        }
        let after = ((self.span.time >> 32) as u32).wrapping_sub(near as u32) as i32;
        let [d1, d2, d3] = self.span.by;
        self.span.time = self.span.time.wrapping_add_signed(d1);
        self.span.by = [d1.wrapping_add(d2), d2.wrapping_add(d3), d3];
        self.span.left -= 1;
        Some(Edge { tick: near.saturating_add_signed(i64::from(after)), up: self.span.up })
    }
}
