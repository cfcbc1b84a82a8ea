//! What the step interrupt does: tops up the rings, and wakes timers that ran dry.

use super::camera::Camera;
use super::lane::Phases;
use super::phase::Phase;
use super::record::{LONGEST, Pulse, RING, Record};
use super::ring::WAKE;
use super::swing::{AMPLITUDE, Quarter};
use super::track::Track;
use parfocal_protocol::units::{AXES, BoardTime};

/// The step interrupt comes this often, ticks: 100 µs. At the top rate it lays 191 records, of a ring of 512.
pub const SERVICE: u32 = 8_400;

/// How far ahead rings are filled, ticks: 2.5 ms.
pub const LEAD: u64 = 210_000;

/// A motion whose pulses stood still for longer than this, ticks, is stopped: 2.5 ms.
pub const GAP: u64 = 210_000;

/// Silence laid before the timers start, ticks.
const START: u32 = 20 * LONGEST;

/// Length of the silent period that timers begin with, ticks; record 0 begins after it.
pub const FIRST: u32 = 168;

/// Timer ticks a µs.
pub const TICKS_PER_US: u64 = 84;

/// What the engine needs of the step timers and their DMA streams.
pub trait StepTimers {
    /// Words that an axis' stream has left in this lap of its ring: NDTR.
    fn left(&mut self, axis: usize) -> u32;

    /// One update by software (EGR.UG, with its DMA request), which wakes a timer that stands at the guard.
    fn wake(&mut self, axis: usize);

    /// CNT of an axis; lets the engine see whether DMA was ever too late for a record. `None` where it cannot be read.
    fn count(&mut self, axis: usize) -> Option<u32> {
        let _ = axis;
        None
    }

    /// Counts the records of an axis for camera pulses from now on, `playing` being the one that plays, for `ticks` in all.
    /// False when that is not certain now, or this axis' cannot be counted.
    fn follow(&mut self, axis: usize, playing: u32, ticks: u32) -> bool {
        let _ = (axis, playing, ticks);
        false
    }

    /// Lets the camera pulse begin with a record of the axis followed. False when it is too late for that.
    fn arm(&mut self, record: u32) -> bool {
        let _ = record;
        false
    }

    /// Whether the pulse that was armed has begun.
    fn fired(&mut self) -> bool {
        false
    }

    /// Ends the pulse, or takes it back.
    fn disarm(&mut self) {}

    /// A free-running counter at [`CLOCK_PER_TICK`] times the step timers' rate, e.g. the cycle counter. Wraps at 2³².
    fn clock(&mut self) -> u32;
}

/// Cycles of [`StepTimers::clock`] a tick.
pub const CLOCK_PER_TICK: u32 = 2;

/// A time without pulses in mid-motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// How long the pulses stood still, ticks.
    pub ticks: u64,
    /// An axis that ran dry first.
    pub axis: usize,
}

/// Feeds the rings from which DMA plays pulses. Owned by the step interrupt; reached through
/// [`crate::ports::Board::pulses`].
///
/// All axes share a timeline of ticks: tick 84·µs of the board's clock, later by what all of them stood still together.
#[derive(Debug)]
pub struct Engine {
    tracks: [Track; AXES],
    /// Edges of the swing of the axis that vibrates.
    quarter: Quarter,
    /// Tick reached.
    now: u64,
    /// Ticks the timeline is behind the board's clock.
    behind: u64,
    clock: u32,
    /// Part of a tick not yet counted in `now`, in clock cycles.
    rest: u32,
    lead: u64,
    /// An axis ran dry, or nearly: nothing is published until every timer stands.
    dry: Option<usize>,
    /// Longest gap in motion since it was last asked for.
    gap: Option<Gap>,
    gaps: u32,
    running: bool,
    /// Ticks that each timer's count is off the clock, since they were started.
    skew: [Option<i64>; AXES],
    /// The axis to be looked at next for records that DMA delivered too late.
    look: usize,
    late: Option<usize>,
    camera: Camera,
}

/// Ticks by which a timer may be off the clock: software reads one after the other. A record is longer.
const OFF: i64 = 30;

impl Default for Engine {
    fn default() -> Self {
        Self::new()
    }
}

impl Engine {
    /// Timers not running.
    pub const fn new() -> Self {
        Self {
            tracks: [const { Track::new() }; AXES],
            quarter: [0; AMPLITUDE],
            now: 0,
            behind: 0,
            clock: 0,
            rest: 0,
            lead: LEAD,
            dry: None,
            gap: None,
            gaps: 0,
            running: false,
            skew: [None; AXES],
            look: 0,
            late: None,
            camera: Camera::new(),
        }
    }

    /// An axis' ring: its stream reads [`RING`] records from here, in a circle. Axes beyond the last give the last.
    pub fn ring(&self, axis: usize) -> &[Record; RING] {
        self.tracks[axis.min(AXES - 1)].ring.slots()
    }

    /// Lays silence into every ring from slot 0, for streams that are not running; the caller then points the streams at
    /// [`Self::ring`], starts them and all timers with a silent period of [`FIRST`] ticks at the levels of record 0, and calls [`Self::service`] every [`SERVICE`] ticks. `clock` is
    /// [`StepTimers::clock`] now.
    pub fn start(&mut self, now: BoardTime, clock: u32) {
        self.now = now.0 * TICKS_PER_US;
        self.behind = 0;
        (self.clock, self.rest) = (clock, 0);
        (self.lead, self.dry, self.skew) = (LEAD, None, [None; AXES]);
        for track in &mut self.tracks {
            track.prepare(self.now + u64::from(FIRST), START);
        }
        self.running = true;
    }

    /// The step interrupt: takes note of what was played, and fills up the rings.
    #[inline]
    pub fn service(&mut self, timers: &mut impl StepTimers) {
        if !self.running {
            return;
        }
        self.tell_time(timers.clock());
        for (axis, track) in self.tracks.iter_mut().enumerate() {
            track.ring.seen(timers.left(axis));
            track.rest();
            if track.ring.near() {
                self.dry.get_or_insert(axis);
            }
        }
        if self.dry.is_some() {
            self.wake_when_all_stand(timers);
            return;
        }
        self.compare(timers);
        let watched = self.camera.watches().and_then(|axis| Some((axis, self.tracks.get(axis)?.ring.head())));
        // One horizon for all: should they run dry, then together.
        let mut horizon = self.now + self.lead;
        let mut full = self.now + LEAD;
        for (axis, track) in self.tracks.iter_mut().enumerate() {
            track.fill(horizon, &self.quarter);
            if track.ring.room() == 0 {
                full = full.min(track.end);
                horizon = horizon.min(full);
            }
            let (high, dir) = track.levels();
            track.ring.publish(high, dir, || timers.left(axis));
            if track.ring.near() {
                self.dry.get_or_insert(axis);
            }
        }
        if let Some((axis, from)) = watched
            && let Some(track) = self.tracks.get(axis)
        {
            self.camera.look(track, from);
        }
        self.camera.serve(&self.tracks, timers);
        self.lead = full.saturating_sub(self.now).clamp(u64::from(SERVICE), (self.lead + u64::from(SERVICE)).min(LEAD));
    }

    /// Had DMA not delivered a record by its turn, the one before would have been played again, and the timeline of its axis would
    /// be behind from then on. Looks at one axis each time, while it plays a long record: then NDTR and CNT belong together.
    fn compare(&mut self, timers: &mut impl StepTimers) {
        let axis = self.look;
        self.look = if axis + 1 < AXES { axis + 1 } else { 0 };
        let Some(track) = self.tracks.get(axis) else { return };
        if !track.plays_long() {
            return;
        }
        let left = timers.left(axis);
        let (Some(count), clock) = (timers.count(axis), timers.clock()) else { return };
        // 4 µs after an update DMA has served the request.
        if left != timers.left(axis) || !track.ring.is_at(left) || count < 336 {
            return;
        }
        let now = self.now + u64::from(clock.wrapping_sub(self.clock) / CLOCK_PER_TICK);
        let off = (track.reached() + u64::from(count)).wrapping_sub(now) as i64;
        if axis == 0 && self.skew[0].is_none() && off.abs() < i64::from(SERVICE) {
            // Timers were started, or woken, a little after the clock was read: from now on both agree.
            self.now = self.now.saturating_add_signed(off);
            self.behind = self.behind.saturating_add_signed(-off);
            self.skew = [Some(0), None, None, None];
            return;
        }
        if let Some(skew) = self.skew.get_mut(axis) {
            let was = *skew.get_or_insert(off);
            if (off - was).abs() > OFF {
                *skew = Some(off);
                self.late = Some(axis);
            }
        }
    }

    /// An axis on which DMA was too late for a record since this was last asked: its steps are not what was planned.
    pub fn take_late(&mut self) -> Option<usize> {
        self.late.take()
    }

    fn tell_time(&mut self, clock: u32) {
        let cycles = clock.wrapping_sub(self.clock);
        self.clock = clock;
        self.now += u64::from(cycles / CLOCK_PER_TICK);
        self.rest += cycles % CLOCK_PER_TICK;
        if self.rest >= CLOCK_PER_TICK {
            self.rest -= CLOCK_PER_TICK;
            self.now += 1;
        }
    }

    /// When every timer stands at its guard: wakes all of them, each where the timeline has it.
    fn wake_when_all_stand(&mut self, timers: &mut impl StepTimers) {
        if !self.tracks.iter().all(|t| t.ring.blocked()) {
            return;
        }
        let first = self.tracks.iter().map(Track::reached).min().unwrap_or(0);
        let stood = self.now.saturating_sub(first);
        // All run dry together, those that stand too: what is told is an axis whose steps were late.
        let moves = |axis: &usize| self.tracks.get(*axis).is_some_and(Track::under_way);
        let moving = self.dry.take().filter(moves).or_else(|| (0..AXES).find(moves));
        let stop = moving.is_some() && stood > GAP;
        if stop {
            self.camera.forget(timers);
        }
        for (axis, track) in self.tracks.iter_mut().enumerate() {
            if stop {
                track.abandon();
            }
            let head = track.ring.head();
            track.reopen(first);
            self.camera.moved(axis, track.ring.head().wrapping_sub(head), timers);
            track.fill(first + self.lead, &self.quarter);
            track.close();
        }
        for axis in 0..AXES {
            timers.wake(axis);
        }
        // The timeline stands until the guards' silence is over.
        let from = first.saturating_sub(u64::from(2 * WAKE + LONGEST));
        self.behind += self.now.saturating_sub(from);
        self.now = from;
        // Waking takes its time, axis by axis.
        self.skew = [None; AXES];
        if let Some(axis) = moving {
            self.gaps = self.gaps.wrapping_add(1);
            if self.gap.is_none_or(|g| g.ticks < stood) {
                self.gap = Some(Gap { ticks: stood, axis });
            }
        }
    }

    /// The board has forced the outputs inactive and stopped timers and streams; these are an axis' NDTR and CNT now. Its count
    /// of steps is exact, and nothing of its path is left. [`Self::start`] begins anew.
    pub fn halted(&mut self, axis: usize, left: u32, count: u32) {
        self.running = false;
        self.camera.halted();
        let Some(track) = self.tracks.get_mut(axis) else { return };
        track.halt(left, count);
    }
}

/// For the thread side.
impl Engine {
    /// Tick of the timeline at an instant of the board's clock.
    pub fn tick(&self, at: BoardTime) -> u64 {
        (at.0 * TICKS_PER_US).saturating_sub(self.behind)
    }

    /// The board's clock at a tick.
    pub fn time(&self, tick: u64) -> BoardTime {
        BoardTime((tick + self.behind) / TICKS_PER_US)
    }

    /// The first tick for which no record of these axes is laid.
    pub fn laid(&self, axes: [bool; AXES]) -> u64 {
        self.tracks
            .iter()
            .zip(axes)
            .filter(|(_, take)| *take)
            .map(|(t, _)| t.end)
            .max()
            .unwrap_or(self.now)
            .max(self.now)
    }

    /// Steps at the output, as the interrupt last saw it.
    pub fn steps(&self, axis: usize) -> i32 {
        // With the last edge out, nothing has to be counted back.
        self.tracks.get(axis).map_or(0, |t| if t.out() { t.issued } else { t.played(None) })
    }

    /// Steps that will be out when the records laid are played.
    pub fn issued(&self, axis: usize) -> i32 {
        self.tracks.get(axis).map_or(0, |t| t.issued)
    }

    /// Declares the count of an axis at rest.
    pub fn set_steps(&mut self, axis: usize, steps: i32) {
        if let Some(track) = self.tracks.get_mut(axis) {
            track.set_steps(steps);
        }
    }

    /// Sets how pulses of an axis at rest look.
    pub fn set_pulse(&mut self, axis: usize, pulse: Pulse) {
        if let Some(track) = self.tracks.get_mut(axis) {
            track.set_pulse(pulse);
        }
    }

    /// Whether edges are still to come.
    pub fn busy(&self, axis: usize) -> bool {
        self.tracks.get(axis).is_some_and(Track::busy)
    }

    /// Whether motions ended in a gap that nobody has asked for yet: paths planned before know nothing of it.
    fn is_cut_short(&self) -> bool {
        self.gap.is_some_and(|g| g.ticks > GAP)
    }

    /// Adds phases to an axis. False, and none added, when they do not all fit or a long gap was not taken note of.
    pub fn append(&mut self, axis: usize, phases: &[Phase]) -> bool {
        !self.is_cut_short() && self.tracks.get_mut(axis).is_some_and(|t| t.append(phases))
    }

    /// Replaces the paths of some axes from a tick on: of each one's phase there, so many edges remain, and its new phases
    /// follow. All or nothing: false when an axis has more laid than that, or a long gap was not taken note of.
    pub fn splice(&mut self, tick: u64, plans: &[Option<(u32, Phases)>; AXES]) -> bool {
        let plans = || plans.iter().enumerate().filter_map(|(axis, plan)| Some((axis, plan.as_ref()?)));
        if self.is_cut_short() || !plans().all(|(i, (steps, _))| self.tracks[i].can_cut(tick, *steps)) {
            return false;
        }
        let mut all = true;
        for (axis, (steps, phases)) in plans() {
            // What was cut leaves room for seven phases and more.
            all &= self.tracks[axis].cut(tick, *steps) && self.tracks[axis].append(phases);
        }
        all
    }

    /// Edge times of the one vibration that goes on at a time.
    pub fn quarter(&mut self) -> &mut Quarter {
        &mut self.quarter
    }

    pub(super) fn camera_mut(&mut self) -> &mut Camera {
        &mut self.camera
    }

    pub(super) fn camera_and_tracks(&mut self) -> (&mut Camera, &[Track; AXES]) {
        (&mut self.camera, &self.tracks)
    }

    /// The longest time that pulses stood still in a motion since this was last asked.
    pub fn take_gap(&mut self) -> Option<Gap> {
        self.gap.take()
    }

    /// How often pulses stood still in a motion since the start.
    pub fn gaps(&self) -> u32 {
        self.gaps
    }
}
