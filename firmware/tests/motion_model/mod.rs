//! A board without hardware: the engine, its timers in software, and every edge that came out.
#![allow(dead_code, reason = "each test uses its part")]

pub mod exact;

use parfocal_firmware::motion::engine::{Engine, SERVICE, StepTimers};
use parfocal_firmware::motion::playback::{Change, Playback};
use parfocal_firmware::motion::{Motion, MotionEvent};
use parfocal_firmware::ports::{Board, Inputs, Keep};
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
                out.push((c.tick, dir));
            }
        }
        out
    }
}

pub const ALL: [bool; AXES] = [true; AXES];

/// A board with a clock that tests turn.
pub struct Mock {
    pub bench: Bench,
    pub inputs: Inputs,
    pub enabled: [bool; AXES],
    pub on: bool,
    /// Changes of earlier playbacks are kept; this is where the present one began, ticks.
    pub began: u64,
    /// Whether it has a bootloader, and whether that was entered.
    pub bootloader: bool,
    pub entered: bool,
}

impl Mock {
    pub fn new() -> Self {
        Self {
            bench: Bench::new(),
            inputs: Inputs::default(),
            enabled: [false; AXES],
            on: true,
            began: 0,
            bootloader: false,
            entered: false,
        }
    }

    pub fn now(&self) -> BoardTime {
        BoardTime((self.began + self.bench.timers.tick()) / 84)
    }

    /// Polls every millisecond for `ms`, or until `until` says so; the events.
    pub fn run(
        &mut self,
        motion: &mut Motion,
        ms: u64,
        mut until: impl FnMut(&MotionEvent) -> bool,
    ) -> Vec<MotionEvent> {
        let mut events = Vec::new();
        for _ in 0..ms {
            while let Some(event) = motion.poll(self.now(), self) {
                events.push(event);
                if until(&event) {
                    return events;
                }
            }
            self.bench.run(84_000);
        }
        events
    }

    /// Steps seen at the pins of an axis.
    pub fn seen(&self, axis: usize, both: bool, inverted: bool) -> i32 {
        self.bench.steps(axis, both).iter().map(|(_, dir)| if *dir != inverted { 1 } else { -1 }).sum()
    }
}

impl Board for Mock {
    fn pulses<R>(&mut self, f: impl FnOnce(&mut Engine) -> R) -> R {
        f(&mut self.bench.engine)
    }

    fn inputs(&mut self) -> Inputs {
        self.inputs
    }

    fn enable(&mut self, axis: usize, on: bool) {
        self.enabled[axis] = on;
    }

    fn outputs_off(&mut self) {
        self.on = false;
        for axis in 0..AXES {
            let (left, count) = (self.bench.timers.left(axis), self.bench.timers.count(axis).unwrap());
            self.bench.engine.halted(axis, left, count);
        }
    }

    fn outputs_on(&mut self) {
        self.on = true;
        self.began += self.bench.timers.tick();
        let now = BoardTime(self.began / 84);
        self.bench.engine.start(now, 0);
        self.bench.timers = Playback::new(&self.bench.engine);
    }

    fn keep(&mut self, _: Keep) -> bool {
        true
    }

    fn has_bootloader(&self) -> bool {
        self.bootloader
    }

    fn enter_bootloader(&mut self) {
        self.entered = true;
    }
}
