//! Camera pulses on the very step. A step's record is known once it is laid; the hardware counts the records that begin, and
//! gives the pulse as that one does: no software's latency is in it, nor a gap in the pulses.

use super::engine::{Engine, StepTimers};
use super::record::RING;
use super::track::Track;
use heapless::Deque;

/// Pulses handed over ahead of time.
pub const AHEAD: usize = 8;

/// A step that shall give a pulse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// Number of the pulse in its plan.
    pub index: u16,
    /// The motor count that the step makes.
    pub count: i32,
    /// Towards larger counts.
    pub up: bool,
}

/// A step whose record is laid.
#[derive(Clone, Copy, Debug)]
struct Laid {
    index: u16,
    /// The record that begins with the step, counted from the stream's start.
    record: u32,
    /// The tick at which it begins.
    tick: u64,
}

/// What the output does.
#[derive(Clone, Copy, Debug, Default)]
enum Output {
    /// Low, for long enough to begin another pulse.
    #[default]
    Ready,
    /// Low, to go high with this record.
    Armed(Laid),
    /// High since the last look.
    High,
    /// Low since the last look.
    Low,
}

/// What became of a pulse that was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It will be given.
    Yes,
    /// Nothing more can be taken now.
    Full,
    /// Its step is out, or too near.
    Late,
}

/// The camera's output and what is to come of it.
#[derive(Debug)]
pub struct Camera {
    /// The axis whose records are counted.
    axis: Option<usize>,
    /// The axis whose records shall be counted.
    asked: Option<usize>,
    wanted: Deque<Wanted, AHEAD>,
    laid: Deque<Laid, AHEAD>,
    output: Output,
    given: Deque<(u16, u64), AHEAD>,
}

impl Camera {
    /// No pulses.
    pub const fn new() -> Self {
        Self {
            axis: None,
            asked: None,
            wanted: Deque::new(),
            laid: Deque::new(),
            output: Output::Ready,
            given: Deque::new(),
        }
    }

    /// The axis whose steps give pulses at the moment, if any are wanted.
    #[inline]
    pub fn watches(&self) -> Option<usize> {
        if self.wanted.is_empty() { None } else { self.asked }
    }

    /// An axis has records from `from` on that are new: finds those of wanted steps.
    pub fn look(&mut self, track: &Track, from: u32) {
        while let Some(wanted) = self.wanted.front().copied() {
            if is_ahead(track, &wanted) || self.laid.is_full() {
                return;
            }
            if let Some((record, tick)) = record_of(track, &wanted, from) {
                let _ = self.laid.push_back(Laid { index: wanted.index, record, tick });
            }
            // One that is not there was passed the other way, or jumped over by a declared position.
            self.wanted.pop_front();
        }
    }

    /// Takes the output one step on: once every service.
    pub fn serve(&mut self, tracks: &[Track], timers: &mut impl StepTimers) {
        if self.axis != self.asked {
            let Some(axis) = self.asked else {
                timers.disarm();
                (self.axis, self.output) = (None, Output::Ready);
                return;
            };
            // Counting begins while a long record plays: then it is certain which.
            let track = tracks.get(axis).filter(|t| t.plays_long());
            if let Some(ring) = track.map(|t| &t.ring)
                && ring.is_at(timers.left(axis))
                && timers.follow(axis, ring.playing(), ring.get(ring.playing()).ticks())
                && ring.is_at(timers.left(axis))
            {
                self.axis = Some(axis);
            }
            return;
        }
        let Some(track) = self.axis.and_then(|axis| tracks.get(axis)) else { return };
        self.output = match self.output {
            // Too soon after the one before, or too late to be prepared: no pulse, and none is told.
            Output::Ready => core::iter::from_fn(|| self.laid.pop_front())
                .find(|laid| timers.arm(laid.record))
                .map_or(Output::Ready, Output::Armed),
            Output::Armed(laid) if timers.fired() => {
                // The events' reader takes them every ms; pulses come 0.4 ms apart at least.
                let _ = self.given.push_back((laid.index, laid.tick));
                Output::High
            }
            Output::Armed(laid) if (track.ring.playing().wrapping_sub(laid.record) as i32) > 1 => {
                timers.disarm();
                Output::Low
            }
            Output::Armed(laid) => Output::Armed(laid),
            Output::High => {
                timers.disarm();
                Output::Low
            }
            Output::Low => Output::Ready,
        };
    }

    /// Records of an axis that were laid and not played have moved on by so many.
    pub fn moved(&mut self, axis: usize, records: u32, timers: &mut impl StepTimers) {
        if self.axis != Some(axis) {
            return;
        }
        if let Output::Armed(laid) = self.output
            && !timers.fired()
        {
            timers.disarm();
            self.output = Output::Low;
            if self.laid.is_full() {
                self.laid.pop_back();
            }
            let _ = self.laid.push_front(laid);
        }
        for laid in &mut self.laid {
            laid.record = laid.record.wrapping_add(records);
        }
    }

    /// Nothing of what was laid is played any more.
    pub fn forget(&mut self, timers: &mut impl StepTimers) {
        self.wanted.clear();
        self.laid.clear();
        if let Output::Armed(_) = self.output {
            timers.disarm();
            self.output = Output::Low;
        }
    }

    /// The timers were stopped, and count from 0 when they run again.
    pub fn halted(&mut self) {
        self.axis = None;
        self.output = Output::Ready;
        self.wanted.clear();
        self.laid.clear();
    }
}

/// Whether a step is still to be laid.
fn is_ahead(track: &Track, wanted: &Wanted) -> bool {
    let ahead = wanted.count.wrapping_sub(track.issued);
    if wanted.up { ahead > 0 } else { ahead < 0 }
}

/// The record that begins with a step (with both edges being steps: that has the step in it), and its tick, among those laid
/// from `from` on.
fn record_of(track: &Track, wanted: &Wanted, from: u32) -> Option<(u32, u64)> {
    let (mut count, mut tick) = (track.issued, track.end);
    let head = track.ring.head();
    for back in 1..=head.wrapping_sub(from).min(RING as u32) {
        let at = head.wrapping_sub(back);
        let record = track.ring.get(at);
        tick = tick.saturating_sub(record.ticks().into());
        let before = count.wrapping_sub(track.steps_of(&record, track.ring.get(at.wrapping_sub(1)).ends_high()));
        let makes = if wanted.up {
            before < wanted.count && wanted.count <= count
        } else {
            count <= wanted.count && wanted.count < before
        };
        if makes {
            return Some((at, tick));
        }
        count = before;
    }
    None
}

/// For the thread side.
impl Engine {
    /// Sets the axis whose steps give pulses, or none; all that were wanted are forgotten.
    pub fn watch_for_camera(&mut self, axis: Option<usize>) {
        let camera = self.camera_mut();
        camera.asked = axis;
        camera.wanted.clear();
        camera.laid.clear();
        camera.given.clear();
    }

    /// Wants a pulse with a step of the camera's axis, behind those wanted already.
    pub fn want_pulse(&mut self, wanted: Wanted) -> Taken {
        let (camera, tracks) = self.camera_and_tracks();
        let Some(track) = camera.asked.and_then(|axis| tracks.get(axis)) else { return Taken::Late };
        if camera.wanted.is_full() {
            return Taken::Full;
        }
        if is_ahead(track, &wanted) {
            let _ = camera.wanted.push_back(wanted);
            return Taken::Yes;
        }
        if !camera.wanted.is_empty() || camera.laid.is_full() {
            return Taken::Full;
        }
        match record_of(track, &wanted, track.ring.playing().wrapping_add(1)) {
            Some((record, tick)) => {
                let _ = camera.laid.push_back(Laid { index: wanted.index, record, tick });
                Taken::Yes
            }
            None => Taken::Late,
        }
    }

    /// Forgets the pulses wanted whose steps are not laid; the number of the first of them.
    pub fn unwant_pulses(&mut self) -> Option<u16> {
        let camera = self.camera_mut();
        let first = camera.wanted.front().map(|w| w.index);
        camera.wanted.clear();
        first
    }

    /// The next pulse given: its number and the tick of its step.
    pub fn pulse_given(&mut self) -> Option<(u16, u64)> {
        self.camera_mut().given.pop_front()
    }
}
