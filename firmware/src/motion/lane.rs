//! One axis' part in a motion: a path, and how many steps of this axis make a unit of it.

use super::backlash::Play;
use super::path::{Limits, Path, STRETCHES};
use super::phase::Phase;
use super::stretch::{State, count};
use heapless::Vec;

/// Phases of one path.
pub type Phases = Vec<Phase, STRETCHES>;

/// An axis on a path.
#[derive(Clone, Debug)]
pub struct Lane {
    /// Tick at which the path begins.
    pub begin: u64,
    /// The path, never going back.
    pub path: Path,
    /// Steps of this axis in a unit of the path.
    pub scale: f64,
    /// Towards larger counts.
    pub up: bool,
    /// The count at the beginning.
    pub base: i32,
    /// Where the path begins, steps beyond `base` along the motion; within half a step.
    pub offset: f64,
    /// Limits in units of the path. Speed 0: it was told to stop.
    pub limits: Limits,
    /// The screw's play at the beginning.
    pub play: Play,
}

impl Lane {
    /// Tick at which the path ends.
    pub fn end(&self) -> u64 {
        self.begin + self.path.ticks()
    }

    fn signed(&self, counts: f64) -> i32 {
        let counts = counts as i32;
        self.base.wrapping_add(if self.up { counts } else { -counts })
    }

    /// The count where the path ends.
    pub fn target(&self) -> i32 {
        self.signed(count(self.offset + self.path.length() * self.scale, true))
    }

    /// The count at a tick.
    pub fn count_at(&self, tick: u64) -> i32 {
        let ticks = tick.saturating_sub(self.begin);
        if ticks >= self.path.ticks() {
            return self.target();
        }
        self.signed(count(self.offset + self.path.state(ticks).p * self.scale, false))
    }

    /// The path as the engine plays it.
    pub fn phases(&self) -> Phases {
        let mut phases = Phases::new();
        let (mut begin, mut before) = (self.begin, 0.0);
        let stretches = self.path.stretches();
        for (i, stretch) in stretches.iter().enumerate() {
            let behind = count(self.offset + stretch.end * self.scale, i + 1 == stretches.len());
            if let Some(phase) = stretch.phase(self.scale, self.offset, begin, before, behind, self.up) {
                // As many phases as stretches at most.
                let _ = phases.push(phase);
            }
            begin += stretch.ticks;
            before = behind;
        }
        phases
    }

    /// The tick of the edge with which the count becomes `target`; its beginning if the count is that there; `None` if the path
    /// does not get there.
    pub fn tick_of(&self, target: i32) -> Option<u64> {
        let ahead = f64::from(target.wrapping_sub(self.base));
        let ahead = if self.up { ahead } else { -ahead };
        if ahead == 0.0 {
            return Some(self.begin);
        }
        if ahead < 0.0 {
            return None;
        }
        let mut begin = self.begin;
        let stretches = self.path.stretches();
        for (i, s) in stretches.iter().enumerate() {
            if count(self.offset + s.end * self.scale, i + 1 == stretches.len()) >= ahead {
                let on = ahead - 0.5 - (self.offset + s.p * self.scale);
                return Some(begin + (s.time_of(self.scale, on.max(0.0)) + 0.5) as u64);
            }
            begin += s.ticks;
        }
        None
    }

    /// Edges that the stretch at `tick` has before it.
    pub fn steps_before(&self, tick: u64) -> u32 {
        let mut left = tick.saturating_sub(self.begin);
        let mut before = 0.0;
        for s in self.path.stretches() {
            if left < s.ticks {
                break;
            }
            left -= s.ticks;
            before = count(self.offset + s.end * self.scale, false);
        }
        let here = count(self.offset + self.path.state(tick.saturating_sub(self.begin)).p * self.scale, false);
        (here - before).max(0.0) as u32
    }

    /// Where the path is at a tick, an acceleration that still adds speed let go of.
    pub fn state(&self, tick: u64) -> State {
        let state = self.path.state(tick.saturating_sub(self.begin));
        State { a: state.a.min(0.0), ..state }
    }

    /// A lane that goes on from this one at `tick` along `path`, which begins at distance 0 in the units of this one.
    pub fn then(&self, tick: u64, path: Path) -> Self {
        let at = self.offset + self.path.state(tick.saturating_sub(self.begin)).p * self.scale;
        let counts = count(at, false);
        Self {
            begin: tick,
            path,
            scale: self.scale,
            up: self.up,
            base: self.signed(counts),
            offset: at - counts,
            limits: self.limits,
            play: self.play_at(counts),
        }
    }

    fn play_at(&self, counts: f64) -> Play {
        let mut play = self.play;
        play.moved(if self.up { counts as i32 } else { -(counts as i32) });
        play
    }

    /// Steps of the stage at a tick, play taken off.
    pub fn stage_at(&self, tick: u64) -> i32 {
        let motor = self.count_at(tick);
        let mut play = self.play;
        play.moved(motor.wrapping_sub(self.base));
        motor.wrapping_sub(play.slack)
    }

    /// A lane that slows down from `tick` on; `None` when this one comes to rest as soon by itself, or not at all in time.
    pub fn stopping(&self, tick: u64) -> Option<Self> {
        let state = self.state(tick);
        if tick >= self.end() {
            return None;
        }
        let mut path = Path::default();
        path.ramp(State { p: 0.0, ..state }, 0.0, self.limits)?;
        (tick + path.ticks() < self.end()).then(|| {
            let mut lane = self.then(tick, path);
            lane.limits.v = 0.0;
            lane
        })
    }
}
