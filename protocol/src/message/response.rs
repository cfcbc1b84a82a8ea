//! What comes back: who the board is and how it is.

use super::{Label, Role, Session};
use crate::autofocus::ScanState;
use crate::settings::{AxisSettings, BoardSettings, Side};
use crate::units::{AXES, Axis, BoardTime, HostTime, Nanometres, Steps};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// What a request that was carried out, or begun, brings back.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
#[allow(clippy::large_enum_variant, reason = "no allocation on the board: a reply is built in place")]
pub enum Response {
    /// To [`super::Request::Hello`].
    Hello(Hello),
    /// To [`super::Request::Status`].
    Status(Status),
    /// To a move, jog, vibration or homing: begun. An event or the status tells its end.
    Moving {
        /// The number of the motion.
        motion: MotionId,
    },
    /// Done.
    Done,
    /// To [`super::Request::GetAxis`].
    Axis(AxisSettings),
    /// To [`super::Request::GetBoard`].
    Board(BoardSettings),
    /// To [`super::Request::AutofocusState`], and to a sample: where the scan stands now.
    Scan(ScanState),
    /// To [`super::Request::Clock`].
    Clock {
        /// The host's own time, back again.
        sent: HostTime,
        /// The board's time when the request came in.
        received: BoardTime,
        /// The board's time when this left.
        answered: BoardTime,
    },
    /// To [`super::Request::AutofocusSweepSample`].
    Swept {
        /// Where the axis was in the middle of the frame's exposure, by the board's own record of steps.
        z: Nanometres,
        /// Where the scan stands now.
        state: ScanState,
    },
}

/// Counts motions since the board started; 0 is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, Schema, MaxSize)]
pub struct MotionId(pub u32);

/// Who the board is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Hello {
    /// Schema of its messages: a fingerprint of all types.
    pub schema: [u8; 8],
    /// Firmware version: major, minor, patch.
    pub firmware: [u16; 3],
    /// Git revision of the firmware.
    pub git: Label,
    /// The kind of board.
    pub board: Label,
    /// The chip's unique number.
    pub unique_id: [u8; 12],
    /// A number that is new with every start.
    pub boot: u32,
    /// Why it last started.
    pub reset: ResetCause,
    /// Axes it has.
    pub axes: u8,
    /// What this session may do.
    pub role: Role,
    /// Whether settings can be kept over a power cycle on this chip.
    pub can_save: bool,
    /// Why the last host-driven operation ended, if not by itself.
    pub last_stop: Option<StopCause>,
}

/// Why the board started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum ResetCause {
    /// Power came on.
    Power,
    /// The reset pin.
    Pin,
    /// Asked to.
    Software,
    /// The watchdog: the program hung. Outputs went inactive.
    Watchdog,
    /// The program found itself in an impossible state.
    Panic,
}

/// Why something stopped before its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum StopCause {
    /// A host said so.
    Asked,
    /// The host fell silent.
    HostLost,
    /// Another session took control.
    ControlTaken,
    /// A limit switch.
    HardLimit {
        /// The axis.
        axis: Axis,
        /// Which end.
        side: Side,
    },
    /// The emergency-stop input or request.
    Emergency,
    /// Pulses could not be supplied in time.
    Underrun {
        /// The axis.
        axis: Axis,
    },
    /// Homing failed.
    Homing {
        /// The axis.
        axis: Axis,
        /// What is wrong.
        fault: HomingFault,
    },
}

/// What is wrong with a home switch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum HomingFault {
    /// It reads pressed wherever the axis is: stuck, or the wire is broken.
    Stuck,
    /// The axis travelled its whole range without meeting it.
    Missing,
    /// The other end's switch was met: the home side or the direction is set wrong.
    WrongSide,
}

/// How the board is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Status {
    /// Its clock.
    pub time: BoardTime,
    /// Its axes; those from the hello's `axes` on mean nothing.
    pub axes: [AxisStatus; AXES],
    /// The latest motion that was begun.
    pub motion: MotionId,
    /// Whether it is over: last edge out, settling time past.
    pub in_position: bool,
    /// Whether it is held.
    pub held: bool,
    /// Why the latest motion ended early, if it did.
    pub stopped: Option<StopCause>,
    /// Whether the emergency stop is in force.
    pub emergency: bool,
    /// Who has control.
    pub controller: Session,
    /// Where the latest scan stands.
    pub scan: ScanState,
}

/// How an axis is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub struct AxisStatus {
    /// Steps counted at the output. Exact.
    pub steps: Steps,
    /// The same in nm, backlash taken off.
    pub position: Nanometres,
    /// Whether the position can be trusted.
    pub trust: Trust,
    /// Edges are coming out, or the settling time is not over.
    pub moving: bool,
    /// Whether the driver's current is on.
    pub enabled: bool,
    /// Whether the low limit switch is pressed.
    pub at_low: bool,
    /// Whether the high limit switch is pressed.
    pub at_high: bool,
}

/// What a position is worth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Trust {
    /// Never set, homed or restored: zero is where the board was switched on.
    #[default]
    Unknown,
    /// Homed or set, and every step since counted.
    Known,
    /// Kept over a power cycle, parked at the driver's start phase.
    Restored,
    /// Kept over a power cycle, but the driver may have jumped by up to 2 full steps.
    RestoredRoughly,
    /// An emergency stop, an underrun or a reset in motion: home it or set it.
    Lost,
}
