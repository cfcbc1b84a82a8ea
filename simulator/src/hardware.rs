//! Virtual step timers below the firmware's engine, and drivers that count the edges they see.

use parfocal_firmware::motion::playback::{Change, Playback};
use parfocal_firmware::motion::{Engine, SERVICE};
use parfocal_firmware::ports::{Board, Inputs, Keep};
use parfocal_protocol::settings::Edges;
use parfocal_protocol::units::{AXES, BoardTime, Steps};

/// Timer ticks in a µs.
const TICKS_PER_US: u64 = 84;

/// What an axis' driver is wired and switched to.
#[derive(Clone, Copy, Debug, Default)]
pub struct Driver {
    /// Which edges it takes as steps.
    pub edges: Edges,
    /// Whether DIR low means larger positions.
    pub inverted: bool,
    /// Where the motor stands, in steps.
    pub steps: Steps,
    dir: bool,
}

impl Driver {
    /// A driver whose motor stands at `steps`.
    pub fn new(edges: Edges, inverted: bool, steps: Steps) -> Self {
        Self { edges, inverted, steps, dir: false }
    }

    fn sees(&mut self, change: Change) {
        if !change.step {
            self.dir = change.high;
        } else if change.high || self.edges == Edges::Both {
            self.steps.0 += if self.dir == self.inverted { -1 } else { 1 };
        }
    }
}

/// A virtual board's hardware.
#[derive(Debug)]
pub struct Hardware {
    engine: Box<Engine>,
    timers: Option<Playback>,
    drivers: [Driver; AXES],
    now: u64,
    inputs: Inputs,
    enabled: [bool; AXES],
    kept: Vec<Keep>,
}

impl Hardware {
    /// Hardware at a board's start, timers running.
    pub fn new(now: BoardTime, drivers: [Driver; AXES]) -> Self {
        let mut hardware = Self {
            engine: Box::default(),
            timers: None,
            drivers,
            now: now.0 * TICKS_PER_US,
            inputs: Inputs::default(),
            enabled: [true; AXES],
            kept: Vec::new(),
        };
        hardware.outputs_on();
        hardware
    }

    /// What stands at the inputs; switches pressed by a test.
    pub fn inputs_mut(&mut self) -> &mut Inputs {
        &mut self.inputs
    }

    /// What was handed over to be kept, in order.
    pub fn kept(&self) -> &[Keep] {
        &self.kept
    }

    /// Whether a driver's current is on.
    pub fn enabled(&self, axis: usize) -> bool {
        self.enabled.get(axis).copied().unwrap_or(false)
    }

    /// Where a motor stands, by the edges its driver saw: independent of what the firmware counts.
    pub fn motor(&self, axis: usize) -> Steps {
        self.drivers.get(axis).map_or(Steps(0), |d| d.steps)
    }

    /// Plays pulses until `until`, with the step interrupt as often as on the board.
    pub fn play(&mut self, until: BoardTime) {
        let end = until.0 * TICKS_PER_US;
        while self.now < end {
            let service = (self.now / u64::from(SERVICE) + 1) * u64::from(SERVICE);
            let to = service.min(end);
            if let Some(timers) = &mut self.timers {
                let drivers = &mut self.drivers;
                timers.play(&self.engine, to - self.now, |change| drivers[change.axis].sees(change));
                if to == service {
                    self.engine.service(timers);
                }
            }
            self.now = to;
        }
    }
}

impl Board for Hardware {
    fn pulses<R>(&mut self, f: impl FnOnce(&mut Engine) -> R) -> R {
        f(&mut self.engine)
    }

    fn inputs(&mut self) -> Inputs {
        self.inputs
    }

    fn enable(&mut self, axis: usize, on: bool) {
        if let Some(enabled) = self.enabled.get_mut(axis) {
            *enabled = on;
        }
    }

    fn outputs_off(&mut self) {
        use parfocal_firmware::motion::StepTimers;
        let Some(mut timers) = self.timers.take() else { return };
        for axis in 0..AXES {
            // A timer that stands at its guard has counted nothing.
            let (left, count) = (timers.left(axis), timers.count(axis).unwrap_or(0));
            self.engine.halted(axis, left, count);
        }
    }

    fn outputs_on(&mut self) {
        use parfocal_firmware::motion::StepTimers;
        if self.timers.is_none() {
            // The clock starts at 0 with the timers.
            self.engine.start(BoardTime(self.now / TICKS_PER_US), 0);
            let mut timers = Playback::new(&self.engine);
            debug_assert_eq!(timers.clock(), 0);
            self.timers = Some(timers);
        }
    }

    fn keep(&mut self, what: Keep) -> bool {
        self.kept.push(what);
        true
    }

    fn enter_bootloader(&mut self) {}
}
