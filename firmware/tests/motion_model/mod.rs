//! A board without hardware: the engine, its timers in software, and every edge that came out.
#![allow(dead_code, reason = "each test uses its part")]

use parfocal_firmware::motion::engine::{Engine, SERVICE, StepTimers};
use parfocal_firmware::motion::playback::{Change, Playback};
use parfocal_protocol::units::{AXES, BoardTime};

/// The engine with its timers.
pub struct Bench {
    pub engine: Box<Engine>,
    pub timers: Playback,
    pub changes: Vec<Change>,
}

impl Bench {
    pub fn new() -> Self {
        let mut engine = Box::new(Engine::new());
        engine.start(BoardTime(0), 0);
        let timers = Playback::new(&engine);
        Self { engine, timers, changes: Vec::new() }
    }

    /// Lets `ticks` pass, the step interrupt coming every `SERVICE` ticks.
    pub fn run(&mut self, ticks: u64) {
        let end = self.timers.tick() + ticks;
        while self.timers.tick() < end {
            self.pass(u64::from(SERVICE));
            self.engine.service(&mut self.timers);
        }
    }

    /// Lets `ticks` pass without the step interrupt.
    pub fn pass(&mut self, ticks: u64) {
        let changes = &mut self.changes;
        self.timers.play(&self.engine, ticks, |c| changes.push(c));
    }

    /// Ticks of the timeline of an axis' steps, with their direction.
    pub fn steps(&self, axis: usize, both: bool) -> Vec<(u64, bool)> {
        let mut dir = false;
        let mut out = Vec::new();
        // DIR and STEP of one axis come in the order of time.
        for c in self.changes.iter().filter(|c| c.axis == axis) {
            if !c.step {
                dir = c.high;
            } else if c.high || both {
                out.push((c.tick - u64::from(Playback::FIRST), dir));
            }
        }
        out
    }
}

pub const ALL: [bool; AXES] = [true; AXES];
