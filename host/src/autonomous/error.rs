//! Why an autonomous calibration ended, or passed a place over.

use crate::calibration::CalibrationError;
use crate::calibration::chain::ChainError;
use crate::link::LinkError;
use crate::procedure::{NotFound, ProcedureError, Subject};
use crate::rig::{ManipulatorNumber, RigError};
use crate::stage::StageError;
use thiserror::Error;

/// What stopped an autonomous calibration. What was recorded stays recorded.
#[derive(Debug, Error)]
pub enum AutoError {
    /// A move, a frame, a focus.
    #[error(transparent)]
    Procedure(#[from] ProcedureError),
    /// The samples do not give a calibration.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The rig's file.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// The picture is black.
    #[error("the picture is dark: is the light on, and the shutter open?")]
    Dark,
    /// Two looks at the same thing did not agree.
    #[error("{0} was seen in another place in every frame: something moves, or the picture is too poor")]
    Unsteady(Subject),
    /// No pipette is in view.
    #[error(
        "no tip is seen within {reach_um:.0} µm of this height: bring a tip into view, roughly in focus; is the pipette broken or missing?"
    )]
    NoTip {
        /// How far was looked, up and down.
        reach_um: f64,
    },
    /// No tip moves with the manipulator.
    #[error(
        "none of the {seen} tips in view moves with {manipulator}: bring its tip into view; is its pipette broken or missing?"
    )]
    NotMoving {
        /// Whose tip was wanted.
        manipulator: ManipulatorNumber,
        /// Tips in view.
        seen: usize,
    },
    /// Several tips move with one manipulator.
    #[error("{seen} tips move with {manipulator}: where its tip is cannot be told; remove what is not its pipette")]
    SeveralMove {
        /// Whose tip was wanted.
        manipulator: ManipulatorNumber,
        /// Tips that move.
        seen: usize,
    },
    /// Too many places in a row gave nothing.
    #[error("{what}: {passed} places in a row gave no sample, after {got} samples; the last reason: {last}")]
    Lost {
        /// Of which calibration.
        what: String,
        /// Samples taken.
        got: usize,
        /// Places passed over.
        passed: usize,
        /// What went wrong last.
        last: String,
    },
    /// The samples do not settle.
    #[error(
        "{what}: after {samples} samples the standard error is {error_um:.2} µm, and {asked_um} was asked: the detector or the focus is too noisy, or something slips"
    )]
    Unsettled {
        /// Of which calibration.
        what: String,
        /// Samples taken.
        samples: usize,
        /// Standard error reached, µm.
        error_um: f64,
        /// Standard error asked, µm.
        asked_um: f64,
    },
    /// A folder or a file of samples.
    #[error("{path}: {reason}")]
    Records {
        /// The folder or file.
        path: String,
        /// What is wrong with it.
        reason: String,
    },
}

impl AutoError {
    /// Whether another place may still give a sample.
    pub fn is_local(&self) -> bool {
        match self {
            Self::Procedure(error) => error.is_local(),
            Self::Dark | Self::Unsteady(_) => true,
            _ => false,
        }
    }

    /// Whether another tip in view may still do: this one is not seen again, or does not move as a tip does.
    pub fn is_of_one_tip(&self) -> bool {
        self.is_local() || matches!(self, Self::Procedure(ProcedureError::Implausible { .. }))
    }

    /// Whether another manipulator may still be calibrated.
    pub fn is_of_one_manipulator(&self) -> bool {
        match self {
            Self::Procedure(error) => !matches!(
                error,
                ProcedureError::Stage(StageError::Interrupted | StageError::Link(_)) | ProcedureError::Camera(_)
            ),
            Self::Records { .. } | Self::Rig(_) => false,
            _ => true,
        }
    }
}

impl From<NotFound> for AutoError {
    fn from(error: NotFound) -> Self {
        ProcedureError::from(error).into()
    }
}

impl From<StageError> for AutoError {
    fn from(error: StageError) -> Self {
        ProcedureError::from(error).into()
    }
}

impl From<LinkError> for AutoError {
    fn from(error: LinkError) -> Self {
        StageError::from(error).into()
    }
}

impl From<ChainError> for AutoError {
    fn from(error: ChainError) -> Self {
        ProcedureError::from(error).into()
    }
}
