//! What a host can ask for.

use crate::autofocus::{FocusSample, ScanId, ScanParameters, SweepSample};
use crate::settings::{AxisSettings, BoardSettings};
use crate::units::{Axis, Hertz, HostTime, MicrometresPerSecond, Nanometres, PerAxis};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// What a host can ask for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Request {
    /// Who are you? Opens the session. The one request that every board of this protocol version answers.
    Hello {
        /// Whether this session wants to control the board or only to watch.
        role: Role,
    },
    /// How are you?
    Status,
    /// Move in a straight line to absolute positions. Axes at `None` stay.
    Move {
        /// Where to.
        to: PerAxis<Option<Nanometres>>,
        /// Speed along the line; `None` is the fastest the axes allow.
        speed: Option<MicrometresPerSecond>,
    },
    /// Stop every axis. Answered for any session, on any link.
    Stop {
        /// How hard.
        how: Stop,
    },
    /// Keep moving at a speed until told otherwise; 0 decelerates.
    Jog {
        /// The axis.
        axis: Axis,
        /// Signed speed.
        speed: MicrometresPerSecond,
    },
    /// Swing around the present position, ending there.
    Vibrate {
        /// The axis.
        axis: Axis,
        /// Half the distance between the turning points.
        amplitude: Nanometres,
        /// Swings in a second.
        frequency: Hertz,
        /// Whole swings.
        cycles: u16,
    },
    /// Find the home switch.
    Home {
        /// The axis.
        axis: Axis,
    },
    /// Feed hold: decelerate, keep the queue.
    Hold,
    /// Go on after a hold.
    Resume,
    /// One axis' settings.
    GetAxis {
        /// The axis.
        axis: Axis,
    },
    /// Change one axis' settings; kept over a power cycle by [`Request::Save`].
    SetAxis {
        /// The axis.
        axis: Axis,
        /// All of its settings.
        settings: AxisSettings,
    },
    /// The board's settings.
    GetBoard,
    /// Change the board's settings.
    SetBoard {
        /// All of them.
        settings: BoardSettings,
    },
    /// Keep settings over a power cycle.
    Save,
    /// Declare where a resting axis is, without moving it.
    SetPosition {
        /// The axis.
        axis: Axis,
        /// Where it is.
        at: Nanometres,
    },
    /// Driver current on or off.
    Enable {
        /// The axis.
        axis: Axis,
        /// On?
        on: bool,
    },
    /// Leave the emergency stop, once its input is released.
    ClearEmergency,
    /// Trigger pulses for a camera.
    Trigger {
        /// When to pulse.
        plan: TriggerPlan,
    },
    /// Begin a scan for focus.
    AutofocusStart(ScanParameters),
    /// A value for a stepwise scan.
    AutofocusSample(FocusSample),
    /// A value for a sweep.
    AutofocusSweepSample(SweepSample),
    /// Where does the scan stand?
    AutofocusState,
    /// End the scan and return to its start.
    AutofocusAbort {
        /// Which.
        scan: ScanId,
    },
    /// What time is it? For keeping the clocks in step.
    Clock {
        /// The host's time when this was sent.
        sent: HostTime,
    },
    /// Restart into the chip's own USB bootloader.
    EnterDfu,
    /// Ends the session; control is free again. What moves goes on to its end.
    Goodbye,
}

/// What a session wants to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Role {
    /// Read only; STOP is always allowed.
    Watch,
    /// Move and set, if nobody else does.
    Control,
    /// Take control from whoever has it; what was moving is stopped.
    TakeControl,
}

/// How hard to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Stop {
    /// Decelerate along the axis' own limits.
    Decelerate,
    /// Outputs off at once; the position stays counted and is flagged.
    Emergency,
}

/// When trigger pulses are given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum TriggerPlan {
    /// Never.
    Off,
    /// From `first` on, one every `every`, while `axis` passes, `count` in all.
    Every {
        /// The axis whose steps count.
        axis: Axis,
        /// Position of the first pulse.
        first: Nanometres,
        /// Distance to the next.
        every: Nanometres,
        /// How many.
        count: u16,
    },
    /// At listed positions, in the order in which the move passes them.
    At {
        /// The axis whose steps count.
        axis: Axis,
        /// The positions; `len` of them count.
        positions: [Nanometres; 8],
        /// How many of them.
        len: u8,
    },
}
