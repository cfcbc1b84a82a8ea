//! What can be asked of the thread that moves things, and how it answers.

use super::places::NoPlace;
use super::wizard::Plan;
use crate::calibration::chain::Pixel;
use crate::link::LinkError;
use crate::procedure::ProcedureError;
use crate::rig::{AxisName, Device};
use crate::stage::StageError;
use parfocal_protocol::autofocus::{Strategy, Subject};
use parfocal_protocol::units::{HostTime, Micrometres, MicrometresPerSecond};
use thiserror::Error;
use tokio::sync::oneshot;

/// An order that waited longer than this for its turn is not carried out: the world is another by then, ms.
pub const STALE_MS: u64 = 1000;

/// Something to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Order {
    /// Move axes in straight lines to absolute positions, or by distances.
    Move {
        /// Which, and where to.
        to: Vec<(AxisName, Micrometres)>,
        /// Whether these are distances from where they are.
        relative: bool,
        /// Speed along the line; the axes' own if `None`.
        speed: Option<MicrometresPerSecond>,
    },
    /// Bring a clicked place to the centre, or a tip to it.
    Click {
        /// What moves.
        device: Device,
        /// Where in the frame.
        at: Pixel,
    },
    /// Keep an axis moving for a moment longer; 0 lets go.
    Jog {
        /// Which.
        axis: AxisName,
        /// How fast.
        speed: MicrometresPerSecond,
    },
    /// Let go of every jog: the page that held them is gone.
    LetGo,
    /// Bring an axis into focus.
    Autofocus(Focus),
    /// Calibrate something.
    Calibrate(Plan),
    /// Another objective is in the light path, or shall be.
    Objective {
        /// Its name.
        name: String,
        /// Whether the rig's file does not have it yet.
        new: bool,
    },
    /// Leave the emergency stop.
    ClearEmergency,
}

/// How to bring an axis into focus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Focus {
    /// The axis.
    pub axis: AxisName,
    /// How far to look, µm from where it is; its soft limits if `None`.
    pub range_um: Option<[f64; 2]>,
    /// Distance between samples; half a depth of field if `None`.
    pub sample_step: Option<Micrometres>,
    /// How the peak is looked for.
    pub strategy: Strategy,
    /// Peak or phase object.
    pub subject: Subject,
}

/// Why an order was not carried out.
#[derive(Debug, Error)]
pub enum OrderError {
    /// Something else goes on.
    #[error("{0}: wait for its end, or stop it")]
    Busy(String),
    /// It waited too long.
    #[error("it had to wait for its turn for too long and was not carried out: ask again")]
    Stale,
    /// The axes or their boards.
    #[error(transparent)]
    Stage(#[from] StageError),
    /// A click that leads nowhere.
    #[error(transparent)]
    Place(#[from] NoPlace),
    /// A move that would not be safe.
    #[error(transparent)]
    Unsafe(#[from] ProcedureError),
    /// A value that cannot be.
    #[error("{0}")]
    Value(String),
    /// The program ends.
    #[error("the program is ending")]
    Ending,
}

impl From<LinkError> for OrderError {
    fn from(error: LinkError) -> Self {
        Self::Stage(error.into())
    }
}

/// What an order came to: the number of the activity that began.
pub type Answer = Result<u64, OrderError>;

/// An order on its way.
pub struct Envelope {
    /// What.
    pub order: Order,
    /// When it was asked.
    pub at: HostTime,
    /// Whom to answer.
    pub answer: oneshot::Sender<Answer>,
}
