//! What the board's decisions need of the board itself. The STM32, the simulator and tests each implement it.

use crate::motion::Engine;
use parfocal_protocol::message::ResetCause;
use parfocal_protocol::settings::{AxisSettings, BoardSettings};
use parfocal_protocol::units::{AXES, Steps};

/// Inputs, as they read now; not debounced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// Level of each axis' low limit switch: true is electrically high.
    pub low_switch: [bool; AXES],
    /// Level of each axis' high limit switch.
    pub high_switch: [bool; AXES],
    /// Whether the emergency-stop line is open (pressed, or its wire broken).
    pub emergency: bool,
}

/// Something to keep over a power cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Keep {
    /// An axis' settings.
    Axis(usize, AxisSettings),
    /// The board's settings.
    Board(BoardSettings),
    /// Where the axes rest, cleanly; `None` voids what was kept, before a motion begins.
    Position(Option<[RestingPosition; AXES]>),
}

/// Where an axis rests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RestingPosition {
    /// Steps counted.
    pub steps: Steps,
    /// Whether they were known, and not only counted from where the board was switched on.
    pub known: bool,
}

/// What was kept, read once at the start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Kept {
    /// Settings of each axis; `None` where none were saved.
    pub axes: [Option<AxisSettings>; AXES],
    /// Settings of the board.
    pub board: Option<BoardSettings>,
    /// Where the axes rested when power went; `None` when they were moving or stopped in an emergency.
    pub position: Option<[RestingPosition; AXES]>,
}

/// Who this board is, for the hello.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// The kind of board.
    pub board: parfocal_protocol::message::Label,
    /// Git revision of the firmware.
    pub git: parfocal_protocol::message::Label,
    /// The chip's unique number.
    pub unique_id: [u8; 12],
    /// A number that is new with every start.
    pub boot: u32,
    /// Why it started.
    pub reset: ResetCause,
    /// Axes it has, at most [`AXES`].
    pub axes: u8,
    /// Whether settings can be kept on this chip.
    pub can_save: bool,
}

/// The hardware below the controller.
pub trait Board {
    /// Runs `f` on the pulse engine while the step interrupt waits. `f` must be short: the lead in the rings is 2.5 ms.
    fn pulses<R>(&mut self, f: impl FnOnce(&mut Engine) -> R) -> R;

    /// Reads the switches.
    fn inputs(&mut self) -> Inputs;

    /// Driver current on or off.
    fn enable(&mut self, axis: usize, on: bool);

    /// Forces every STEP output inactive and stops the step timers, at once; then tells the engine what was played.
    fn outputs_off(&mut self);

    /// Starts the step timers again, silent, after [`Board::outputs_off`].
    fn outputs_on(&mut self);

    /// Hands something over to be written to flash in the background. False when it cannot be taken now.
    fn keep(&mut self, what: Keep) -> bool;

    /// Whether steps of an axis can give camera pulses.
    fn has_trigger(&self, axis: usize) -> bool {
        axis < AXES
    }

    /// Whether there is a bootloader to restart into.
    fn has_bootloader(&self) -> bool {
        false
    }

    /// Restarts into the USB bootloader. Returns only where there is none.
    fn enter_bootloader(&mut self);
}
