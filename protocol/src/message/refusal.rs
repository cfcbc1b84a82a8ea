//! Why a request was not carried out.

use super::Session;
use crate::autofocus::ScanId;
use crate::settings::Side;
use crate::units::{Axis, BoardTime, Nanometres};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

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
    /// The steps of this axis cannot give camera pulses.
    NoTrigger {
        /// The axis.
        axis: Axis,
    },
    /// A frame's time that a sweep has no place for: exposed before the leg that runs, before the frame told last, or not yet.
    WrongTime {
        /// Earliest time that is welcome.
        earliest: BoardTime,
        /// Latest one: now.
        latest: BoardTime,
    },
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
