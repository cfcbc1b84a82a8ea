//! What the controller sees of motion: settings, status, positions.

use super::backlash::Play;
use super::homing::Homing;
use super::lane::Lane;
use super::limits;
use super::switches::Debounce;
use super::trigger::Triggers;
use crate::ports::Board;
use heapless::{Deque, Vec};
use parfocal_protocol::message::{AxisStatus, MotionId, Refusal, StopCause, Trust};
use parfocal_protocol::settings::{AxisSettings, Polarity, Side};
use parfocal_protocol::units::{AXES, Axis, BoardTime, MicrometresPerSecond, Nanometres, PerAxis, Steps};

/// Moves that wait behind the one that runs.
pub const QUEUE: usize = 8;

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionEvent {
    /// A motion is over: last edge out, settling time past.
    InPosition(MotionId),
    /// A motion ended early, and rests.
    Stopped {
        /// Which.
        motion: MotionId,
        /// Why.
        cause: StopCause,
    },
    /// A camera pulse was given.
    Triggered {
        /// Number of the pulse within its plan, from 0.
        index: u16,
        /// When.
        time: BoardTime,
        /// Where the axis was.
        position: Nanometres,
    },
    /// The emergency-stop input changed.
    EmergencyInput {
        /// Pressed?
        pressed: bool,
    },
}

/// How a move ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ending {
    /// From the side that the axis' settings prefer.
    #[default]
    Approach,
    /// Straight, whatever the settings prefer: for moves of a scan, whose last one alone decides.
    Direct,
}

/// A move as it was asked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wish {
    pub id: MotionId,
    pub to: PerAxis<Option<Nanometres>>,
    pub speed: Option<MicrometresPerSecond>,
    pub ending: Ending,
}

/// Motor counts that axes go to together; `None` rests.
pub(super) type Leg = [Option<i32>; AXES];

/// What is being done.
#[derive(Clone, Debug, Default)]
pub(super) enum Task {
    /// Nothing.
    #[default]
    Rest,
    /// A move: the legs to come, the last of this list first, and the one that runs.
    Line { wish: Wish, now: Leg, then: Vec<Leg, 2> },
    /// Speeds wanted, steps per tick, signed.
    Jog { wanted: [f64; AXES] },
    /// A vibration.
    Swing(super::swing::Swinging),
    /// Looking for a switch.
    Home(Homing),
}

/// One axis as the thread side knows it.
#[derive(Clone, Debug)]
pub(super) struct Known {
    pub settings: AxisSettings,
    pub play: Play,
    /// Motor count up to which `play` is kept.
    pub seen: i32,
    pub trust: Trust,
    pub enabled: bool,
    pub low: Debounce,
    pub high: Debounce,
    pub lane: Option<Lane>,
    /// The lane before, for looking back.
    pub past: Option<Lane>,
}

/// Motion of all axes of a board.
#[derive(Debug)]
pub struct Motion {
    pub(super) axes: [Known; AXES],
    pub(super) task: Task,
    pub(super) queue: Deque<Wish, QUEUE>,
    /// The latest motion accepted.
    pub(super) latest: MotionId,
    /// The one that runs, or ran last.
    pub(super) running: MotionId,
    pub(super) events: Deque<MotionEvent, 16>,
    /// All edges out since.
    pub(super) quiet: Option<BoardTime>,
    pub(super) stopping: Option<StopCause>,
    pub(super) stopped: Option<StopCause>,
    pub(super) held: bool,
    pub(super) triggers: Triggers,
    /// The axis whose records the camera's output counts.
    pub(super) counted: Option<usize>,
    pub(super) emergency: bool,
    pub(super) emergency_input: Debounce,
    pub(super) emergency_wired: bool,
    /// Distance of the running move beyond the straight way: overshoot and back, µm.
    pub(super) approach_um: f32,
}

impl Default for Motion {
    fn default() -> Self {
        Self::new()
    }
}

impl Motion {
    /// All axes at their default settings, at 0, positions unknown. Nothing is moved or enabled.
    pub fn new() -> Self {
        Self {
            axes: core::array::from_fn(|_| Known {
                settings: AxisSettings::default(),
                play: Play::default(),
                seen: 0,
                trust: Trust::Unknown,
                enabled: false,
                low: Debounce::default(),
                high: Debounce::default(),
                lane: None,
                past: None,
            }),
            task: Task::Rest,
            queue: Deque::new(),
            latest: MotionId(0),
            running: MotionId(0),
            events: Deque::new(),
            quiet: None,
            stopping: None,
            stopped: None,
            held: false,
            triggers: Triggers::new(),
            counted: None,
            emergency: false,
            emergency_input: Debounce::default(),
            emergency_wired: false,
            approach_um: 0.0,
        }
    }

    /// Takes over an axis' settings. Its position in µm changes with the scale; the count of steps does not.
    ///
    /// # Errors
    /// [`Refusal::OutOfRange`] naming the field, [`Refusal::Busy`] while anything moves, [`Refusal::NoSuchAxis`].
    pub fn configure(&mut self, board: &mut impl Board, axis: Axis, settings: &AxisSettings) -> Result<(), Refusal> {
        let index = axis.index().ok_or(Refusal::NoSuchAxis { axis })?;
        limits::check(settings)?;
        if !self.resting() {
            return Err(Refusal::Busy);
        }
        self.track_play(board);
        let Some(known) = self.axes.get_mut(index) else { return Err(Refusal::NoSuchAxis { axis }) };
        known.settings = *settings;
        known.play.set_width(settings.steps_per_um.steps(settings.backlash).0);
        board.pulses(|engine| engine.set_pulse(index, limits::pulse(settings)));
        Ok(())
    }

    /// An axis' settings; those of the last axis for one that no board has.
    pub fn settings(&self, axis: Axis) -> &AxisSettings {
        &self.known(axis.index().unwrap_or(AXES - 1)).settings
    }

    pub(super) fn known(&self, axis: usize) -> &Known {
        &self.axes[axis.min(AXES - 1)]
    }

    pub(super) fn known_mut(&mut self, axis: usize) -> &mut Known {
        &mut self.axes[axis.min(AXES - 1)]
    }

    /// Whether the emergency-stop input is wired.
    pub fn set_emergency_wired(&mut self, wired: bool) {
        self.emergency_wired = wired;
    }

    /// Declares where a resting axis is.
    ///
    /// # Errors
    /// [`Refusal::Busy`] while anything moves, [`Refusal::NoSuchAxis`].
    pub fn set_position(&mut self, board: &mut impl Board, axis: Axis, at: Nanometres) -> Result<(), Refusal> {
        self.restore(board, axis, self.settings(axis).steps_per_um.steps(at), Trust::Known)
    }

    /// Declares the stage's steps of a resting axis and what they are worth, e.g. from before a power cycle.
    ///
    /// # Errors
    /// As [`Self::set_position`].
    pub fn restore(&mut self, board: &mut impl Board, axis: Axis, at: Steps, trust: Trust) -> Result<(), Refusal> {
        let index = axis.index().ok_or(Refusal::NoSuchAxis { axis })?;
        if !self.resting() {
            return Err(Refusal::Busy);
        }
        self.track_play(board);
        let known = self.known_mut(index);
        if matches!(trust, Trust::Restored | Trust::RestoredRoughly) {
            // Every move ends from the approach side, so the play lay there.
            known.play.slack = if known.settings.approach == Some(Side::Low) { known.play.width } else { 0 };
        }
        let motor = at.0.saturating_add(known.play.slack);
        known.seen = motor;
        known.trust = trust;
        // The paths of before count from another zero.
        (known.lane, known.past) = (None, None);
        board.pulses(|engine| engine.set_steps(index, motor));
        Ok(())
    }

    /// The stage's steps (play taken off) of an axis at rest, to be kept over a power cycle, and whether they are known.
    pub fn resting_steps(&self, board: &mut impl Board, axis: Axis) -> (Steps, bool) {
        let index = axis.index().unwrap_or(AXES - 1);
        let motor = board.pulses(|engine| engine.steps(index));
        let known = self.known(index);
        (Steps(self.stage(index, motor)), !matches!(known.trust, Trust::Unknown | Trust::Lost))
    }

    /// Driver current on or off.
    ///
    /// # Errors
    /// [`Refusal::Busy`] when switched off in motion, [`Refusal::NoSuchAxis`].
    pub fn enable(&mut self, board: &mut impl Board, axis: Axis, on: bool) -> Result<(), Refusal> {
        let index = axis.index().ok_or(Refusal::NoSuchAxis { axis })?;
        if !on && !self.resting() {
            return Err(Refusal::Busy);
        }
        self.known_mut(index).enabled = on;
        board.enable(index, on);
        Ok(())
    }

    /// Stage steps of a motor count, the play followed from where it was last kept.
    pub(super) fn stage(&self, axis: usize, motor: i32) -> i32 {
        let known = self.known(axis);
        let mut play = known.play;
        play.moved(motor.wrapping_sub(known.seen));
        motor.wrapping_sub(play.slack)
    }

    /// Follows the play to where the motors are now.
    pub(super) fn track_play(&mut self, board: &mut impl Board) {
        for axis in 0..AXES {
            let motor = board.pulses(|engine| engine.steps(axis));
            let known = self.known_mut(axis);
            known.play.moved(motor.wrapping_sub(known.seen));
            known.seen = motor;
        }
    }

    /// How an axis is.
    pub fn status(&self, board: &mut impl Board, axis: Axis) -> AxisStatus {
        let index = axis.index().unwrap_or(AXES - 1);
        let (motor, busy) = board.pulses(|engine| (engine.steps(index), engine.busy(index)));
        let known = self.known(index);
        AxisStatus {
            steps: Steps(motor),
            position: known.settings.steps_per_um.nanometres(Steps(self.stage(index, motor))),
            trust: known.trust,
            moving: busy || (known.lane.is_some() && !self.resting()),
            enabled: known.enabled,
            at_low: known.low.level(),
            at_high: known.high.level(),
        }
    }

    /// Where an axis' stage was at an instant within its latest two paths, or is while it rests; `None` before that.
    pub fn position_at(&self, board: &mut impl Board, axis: Axis, at: BoardTime) -> Option<Nanometres> {
        let index = axis.index()?;
        let (tick, motor) = board.pulses(|engine| (engine.tick(at), engine.issued(index)));
        let known = self.known(index);
        let lane = known.lane.iter().chain(&known.past).find(|lane| lane.begin <= tick);
        let stage = match (lane, &known.lane, &known.past) {
            (Some(lane), ..) => lane.stage_at(tick),
            (None, Some(first), None) | (None, _, Some(first)) => first.stage_at(0),
            (None, None, None) => self.stage(index, motor),
        };
        Some(known.settings.steps_per_um.nanometres(Steps(stage)))
    }

    /// Steps at the outputs, for telemetry.
    pub fn steps(&self, board: &mut impl Board) -> PerAxis<Steps> {
        core::array::from_fn(|axis| Steps(board.pulses(|engine| engine.steps(axis))))
    }

    /// The latest motion accepted.
    pub fn motion(&self) -> MotionId {
        self.latest
    }

    /// Whether every motion accepted is over, settling time included.
    pub fn in_position(&self) -> bool {
        self.resting() && self.queue.is_empty()
    }

    /// Nothing is being done.
    pub(super) fn resting(&self) -> bool {
        matches!(self.task, Task::Rest)
    }

    /// Whether a hold is in force.
    pub fn held(&self) -> bool {
        self.held
    }

    /// Why the latest motion ended early, if it did.
    pub fn stopped(&self) -> Option<StopCause> {
        self.stopped
    }

    /// Whether the emergency stop is in force.
    pub fn emergency_in_force(&self) -> bool {
        self.emergency
    }

    /// Way of the latest move beyond the straight one: overshoot and back, µm.
    pub fn approach_um(&self) -> f32 {
        self.approach_um
    }

    /// Whether a limit switch is pressed, as debounced.
    pub(super) fn pressed(&self, axis: usize, side: Side) -> bool {
        let known = self.known(axis);
        known.settings.has_switches
            && match side {
                Side::Low => known.low.level(),
                Side::High => known.high.level(),
            }
    }

    /// What a raw level means.
    pub(super) fn means_pressed(settings: &AxisSettings, level: bool) -> bool {
        settings.has_switches && level == (settings.switches == Polarity::PressedHigh)
    }

    pub(super) fn next_id(&mut self) -> MotionId {
        self.latest = MotionId(self.latest.0.wrapping_add(1).max(1));
        self.latest
    }

    pub(super) fn tell(&mut self, event: MotionEvent) {
        if self.events.is_full() {
            // Whoever does not ask for events reads the status; the newest are worth most.
            self.events.pop_front();
        }
        let _ = self.events.push_back(event);
    }
}
