//! What the board tells without being asked.

use super::{MotionId, StopCause};
use crate::autofocus::{SampleWanted, ScanReport};
use crate::units::{BoardTime, Nanometres, PerAxis, Steps};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

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
