//! The same moves on a PC: the firmware's own motion library, with its rings played in software. What the emulated timers
//! put out must be this, tick by tick.

use parfocal_firmware::motion::playback::{Change, Playback};
use parfocal_firmware::motion::{Ending, Engine, Motion, SERVICE};
use parfocal_firmware::ports::{Board, Inputs, Keep};
use parfocal_protocol::message::Refusal;
use parfocal_protocol::settings::AxisSettings;
use parfocal_protocol::units::{AXES, Axis, BoardTime, MicrometresPerSecond, Nanometres, PerAxis};

/// Ticks in a µs.
const TICKS_PER_US: u64 = 84;

/// A board without a chip.
struct Desk {
    engine: Box<Engine>,
}

impl Board for Desk {
    fn pulses<R>(&mut self, f: impl FnOnce(&mut Engine) -> R) -> R {
        f(&mut self.engine)
    }
    fn inputs(&mut self) -> Inputs {
        Inputs::default()
    }
    fn enable(&mut self, _: usize, _: bool) {}
    fn outputs_off(&mut self) {}
    fn outputs_on(&mut self) {}
    fn keep(&mut self, _: Keep) -> bool {
        false
    }
    fn enter_bootloader(&mut self) {}
}

/// Moves on a PC.
pub struct Planned {
    desk: Desk,
    motion: Motion,
    playback: Playback,
}

impl Planned {
    /// A board with these settings, at rest at 0.
    ///
    /// # Errors
    /// When settings are refused.
    pub fn new(settings: &[AxisSettings; AXES]) -> Result<Self, Refusal> {
        let mut desk = Desk { engine: Box::new(Engine::new()) };
        desk.engine.start(BoardTime(0), 0);
        let playback = Playback::new(&desk.engine);
        let mut motion = Motion::new();
        for (axis, settings) in settings.iter().enumerate() {
            motion.configure(&mut desk, Axis(axis as u8), settings)?;
        }
        Ok(Self { desk, motion, playback })
    }

    /// Moves, and lists every change of an output until the axes rest.
    ///
    /// # Errors
    /// When the move is refused.
    pub fn move_to(
        &mut self,
        to: &PerAxis<Option<Nanometres>>,
        speed: Option<MicrometresPerSecond>,
    ) -> Result<Vec<Change>, Refusal> {
        let mut changes = Vec::new();
        let now = self.now();
        self.motion.move_to(now, &mut self.desk, to, speed, Ending::Approach)?;
        // A motion that rests has told its end; ten services make the ms after which it is asked again.
        while !self.motion.in_position() {
            for _ in 0..10 {
                self.desk.engine.service(&mut self.playback);
                self.playback.play(&self.desk.engine, SERVICE.into(), |change| changes.push(change));
            }
            let now = self.now();
            while self.motion.poll(now, &mut self.desk).is_some() {}
        }
        changes.sort_by_key(|c| c.tick);
        Ok(changes)
    }

    fn now(&self) -> BoardTime {
        BoardTime(self.playback.tick() / TICKS_PER_US)
    }
}
