//! Requests, replies and events.
//!
//! New variants go to the end of their enum and a changed one becomes a new one: `tests/wire.rs` pins every byte.

use crate::autofocus::{FocusSample, SampleWanted, ScanId, ScanParameters, ScanReport, ScanState, SweepSample};
use crate::settings::{AxisSettings, BoardSettings, Side};
use crate::units::{AXES, Axis, BoardTime, Hertz, HostTime, MicrometresPerSecond, Nanometres, PerAxis, Steps};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A host's connection, by a number of its own choice; 0 is nobody.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema, MaxSize)]
pub struct Session(pub u32);

/// Counts a session's requests from 1. A repeated number is the same request again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, Schema, MaxSize)]
pub struct Sequence(pub u32);

/// Text of at most 16 bytes, UTF-8, padded with zeros.
#[derive(Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema, MaxSize)]
pub struct Label(pub [u8; 16]);

impl Label {
    /// The first 16 bytes of `text`, cut at a character's border.
    pub fn new(text: &str) -> Self {
        let mut end = text.len().min(16);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        let mut bytes = [0; 16];
        bytes[..end].copy_from_slice(&text.as_bytes()[..end]);
        Self(bytes)
    }

    /// The text; empty when it is not UTF-8.
    pub fn as_str(&self) -> &str {
        let end = self.0.iter().position(|b| *b == 0).unwrap_or(self.0.len());
        core::str::from_utf8(&self.0[..end]).unwrap_or("")
    }
}

impl core::fmt::Debug for Label {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

/// From host to board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub struct ToBoard {
    /// Who asks.
    pub session: Session,
    /// The number of this request.
    pub sequence: Sequence,
    /// What is asked.
    pub request: Request,
}

/// From board to host.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
#[allow(clippy::large_enum_variant, reason = "no allocation on the board: a reply is built in place")]
pub enum FromBoard {
    /// The answer to the request with this number.
    Reply {
        /// Who asked.
        session: Session,
        /// Which request.
        sequence: Sequence,
        /// What came of it.
        result: Result<Response, Refusal>,
    },
    /// Something happened.
    Event {
        /// Counts events: a gap means that one was lost, and a status tells what it said.
        count: u32,
        /// What happened.
        event: Event,
    },
}

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

/// What a request that was carried out, or begun, brings back.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
#[allow(clippy::large_enum_variant, reason = "no allocation on the board: a reply is built in place")]
pub enum Response {
    /// To [`Request::Hello`].
    Hello(Hello),
    /// To [`Request::Status`].
    Status(Status),
    /// To a move, jog, vibration or homing: begun. An event or the status tells its end.
    Moving {
        /// The number of the motion.
        motion: MotionId,
    },
    /// Done.
    Done,
    /// To [`Request::GetAxis`].
    Axis(AxisSettings),
    /// To [`Request::GetBoard`].
    Board(BoardSettings),
    /// To [`Request::AutofocusState`], and to a sample: where the scan stands now.
    Scan(ScanState),
    /// To [`Request::Clock`].
    Clock {
        /// The host's own time, back again.
        sent: HostTime,
        /// The board's time when the request came in.
        received: BoardTime,
        /// The board's time when this left.
        answered: BoardTime,
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

/// What the board tells without being asked.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Event {
    /// Where the axes are, while something moves.
    Position {
        /// When.
        time: BoardTime,
        /// Steps at the outputs.
        steps: PerAxis<Steps>,
    },
    /// A motion is over: last edge out, settling time past.
    InPosition {
        /// Which.
        motion: MotionId,
    },
    /// A motion ended early.
    Stopped {
        /// Which.
        motion: MotionId,
        /// Why.
        cause: StopCause,
    },
    /// A scan wants a sample.
    SampleWanted(SampleWanted),
    /// A scan ended.
    ScanEnded(ScanReport),
    /// A camera trigger was given.
    Triggered {
        /// Number of the pulse within its plan, from 0.
        index: u16,
        /// When.
        time: BoardTime,
        /// Where the axis was.
        position: Nanometres,
    },
    /// The emergency-stop input was pressed or released.
    EmergencyInput {
        /// Pressed?
        pressed: bool,
    },
}

/// Why a request was not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Refusal {
    /// This session has not said hello since the board started.
    NoSession,
    /// Another session has control.
    NotInControl {
        /// Which.
        controller: Session,
    },
    /// A number lower than the last one of this session.
    OldSequence,
    /// The board has no such axis.
    NoSuchAxis {
        /// What was asked for.
        axis: Axis,
    },
    /// The end of the move lies beyond a soft limit.
    BeyondLimit {
        /// The axis.
        axis: Axis,
        /// Lowest position allowed.
        low: Nanometres,
        /// Highest position allowed.
        high: Nanometres,
    },
    /// The axis is moving.
    Busy,
    /// The queue of moves is full.
    QueueFull,
    /// The emergency stop is in force.
    Emergency,
    /// A limit switch is pressed in the direction of the move.
    AtHardLimit {
        /// The axis.
        axis: Axis,
        /// Which end.
        side: Side,
    },
    /// A field is out of range.
    OutOfRange {
        /// Which field.
        field: Field,
        /// Lowest allowed value, in the field's unit.
        low: f32,
        /// Highest allowed value.
        high: f32,
    },
    /// No scan of this number is running.
    NoSuchScan {
        /// The scan that runs or ran last, if any.
        current: Option<ScanId>,
    },
    /// Not the sample that is wanted now.
    WrongSample {
        /// The one that is.
        wanted: u32,
    },
    /// The value is not a finite number.
    NotANumber,
    /// The axis has no home switch.
    NoHomeSwitch {
        /// The axis.
        axis: Axis,
    },
    /// Flash could not be written, or is out of bounds on this chip revision.
    CannotSave,
    /// The board's build cannot do this.
    Unsupported,
}

/// Fields that [`Refusal::OutOfRange`] names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Field {
    /// Steps per µm.
    StepsPerUm,
    /// Speed, µm/s.
    Speed,
    /// Acceleration, µm/s².
    Acceleration,
    /// Jerk, µm/s³.
    Jerk,
    /// Lower soft limit, µm.
    Low,
    /// Upper soft limit, µm.
    High,
    /// Backlash, µm.
    Backlash,
    /// Settling time, ms.
    Settling,
    /// Homing speed, µm/s.
    HomeSpeed,
    /// Position of the home switch, µm.
    HomeAt,
    /// Host timeout, ms.
    HostTimeout,
    /// Telemetry rate, Hz.
    Telemetry,
    /// Sample step of a scan, µm.
    SampleStep,
    /// Trap radius of a scan, µm.
    Trap,
    /// Probe length of a scan, µm.
    Probe,
    /// Range of a scan, µm.
    ScanRange,
    /// Sample timeout of a scan, ms.
    SampleTimeout,
    /// Amplitude of a vibration, µm.
    Amplitude,
    /// Frequency of a vibration, Hz.
    Frequency,
    /// Cycles of a vibration.
    Cycles,
    /// Distance or count of trigger pulses.
    Trigger,
    /// Microsteps in a full step.
    Microsteps,
}
