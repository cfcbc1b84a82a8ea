//! Runs: many short pulses out of one span. These are the inner loops of the step interrupt: what a step costs at high rates
//! is decided here.

use super::phase::Span;
use super::record::{LONGEST, Record, SHORTEST};
use super::ring::Maker;
use super::track::Track;

/// Most records of a run: counts are remembered in between (see [`super::marks`]).
const RUN: u32 = 64;

/// Times of a span's edges, one after another: ticks modulo 2³².
trait Times {
    fn next(&mut self) -> u32;
}

/// Constant speed.
struct Even {
    time: u64,
    by: i64,
}

impl Times for Even {
    #[inline(always)]
    fn next(&mut self) -> u32 {
        let tick = (self.time >> 32) as u32;
        self.time = self.time.wrapping_add_signed(self.by);
        tick
    }
}

/// A cubic, by forward differences; the third is small, and one register less makes the loop a fifth shorter.
struct Curved {
    time: u64,
    by: [i64; 2],
    third: i32,
}

impl Times for Curved {
    #[inline(always)]
    fn next(&mut self) -> u32 {
        let tick = (self.time >> 32) as u32;
        let [d1, d2] = self.by;
        self.time = self.time.wrapping_add_signed(d1);
        self.by = [d1.wrapping_add(d2), d2.wrapping_add(i64::from(self.third))];
        tick
    }
}

/// A step a record: it opens with the rising edge.
struct Single<T> {
    times: T,
    /// When the next record begins.
    open: u32,
    high: u32,
    dir: u32,
}

impl<T: Times> Maker for Single<T> {
    #[inline(always)]
    fn make(&mut self) -> Record {
        let next = self.times.next();
        let record = Record::pulse(next.wrapping_sub(self.open), self.high, self.dir);
        self.open = next;
        record
    }
}

/// Two steps a record: it opens with the rising edge, and the falling one is within.
struct Pair<T> {
    times: T,
    open: u32,
    dir: u32,
}

impl<T: Times> Maker for Pair<T> {
    #[inline(always)]
    fn make(&mut self) -> Record {
        let (fall, next) = (self.times.next(), self.times.next());
        let record = Record::pulse(next.wrapping_sub(self.open), fall.wrapping_sub(self.open), self.dir);
        self.open = next;
        record
    }
}

impl Track {
    /// Lays short pulses of the span that is being generated, as many as belong together; 0 when its next ones are not such.
    pub(super) fn run(&mut self, horizon: u64, room: u32) -> u32 {
        let steps = if self.pulse.both { 2 } else { 1 };
        let records = self.run_length(horizon, room, steps);
        if records == 0 {
            return 0;
        }
        let Span { time, by: [d1, d2, d3], .. } = self.edges.span;
        if d2 == 0 && d3 == 0 {
            let times = self.lay_run(Even { time, by: d1 }, records);
            self.edges.span.time = times.time;
        } else {
            let Ok(third) = i32::try_from(d3) else { return 0 };
            let times = self.lay_run(Curved { time, by: [d1, d2], third }, records);
            self.edges.span.time = times.time;
            self.edges.span.by = [times.by[0], times.by[1], d3];
        }
        self.edges.span.left -= records * steps;
        self.count((records * steps) as i32);
        self.mark();
        records
    }

    /// How many records a run can have. In a span the intervals change by an eighth at most: what holds of the first holds of
    /// all.
    fn run_length(&self, horizon: u64, room: u32, steps: u32) -> u32 {
        let Span { left, time, by: [d1, ..], .. } = self.edges.span;
        let first = ((time >> 32) as u32).wrapping_sub(self.end as u32);
        let next = (d1 >> 32) as u32;
        let short = SHORTEST / steps - 2..LONGEST * 3 / 4 / steps;
        if !short.contains(&first) || !short.contains(&next) {
            return 0;
        }
        let ticks = horizon.saturating_sub(self.end).min(1 << 24) as u32;
        (left / steps).min(room).min(ticks / (next * steps) + 1).min(RUN)
    }

    /// Lays that many records; gives back where the times stand then.
    #[inline(always)]
    fn lay_run<T: Times>(&mut self, times: T, records: u32) -> T {
        let (open, high, dir) = (self.end as u32, self.pulse.high, self.dir);
        let (times, open) = if self.pulse.both {
            let pair = self.ring.lay(records, Pair { times, open, dir });
            (pair.times, pair.open)
        } else {
            let single = self.ring.lay(records, Single { times, open, high, dir });
            (single.times, single.open)
        };
        self.end += u64::from(open.wrapping_sub(self.end as u32));
        times
    }
}
