//! Why a live procedure ended. What was recorded until then stays recorded; no calibration was changed.

use super::obstacles::Collision;
use super::point::NotFound;
use crate::autofocus::ScanError;
use crate::calibration::CalibrationError;
use crate::calibration::chain::ChainError;
use crate::frames::camera::CameraError;
use crate::rig::{AxisName, Device, ManipulatorNumber};
use crate::stage::StageError;
use std::path::PathBuf;
use thiserror::Error;

/// Why a live procedure, or a guarded move, did not do what was asked.
#[derive(Debug, Error)]
pub enum ProcedureError {
    /// An axis.
    #[error(transparent)]
    Stage(#[from] StageError),
    /// A tip would run into something.
    #[error(transparent)]
    Collision(#[from] Collision),
    /// Something is not calibrated, or nobody said which objective is in use.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// The samples do not give a calibration.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The scan could not be carried through.
    #[error(transparent)]
    Autofocus(#[from] ScanError),
    /// The point is not there.
    #[error(transparent)]
    NotFound(#[from] NotFound),
    /// The camera shows only what was before the move.
    #[error(
        "the camera delivered no frame exposed after the move within {millis} ms: check its cable and its frame rate"
    )]
    NoFreshFrame {
        /// How long was waited.
        millis: u64,
    },
    /// Frames are not as the rig's file says.
    #[error(
        "the camera's frames are {found}, but by camera.width_px, height_px, crop_px and binning of the rig's file they are {expected}: correct the file, or set the camera back"
    )]
    FrameSize {
        /// Size of the frames.
        found: String,
        /// Size by the file.
        expected: String,
    },
    /// The board refused to call it in focus.
    #[error("{axis} was not focused at this place: {reason}")]
    NotFocused {
        /// The axis that moved.
        axis: AxisName,
        /// The board's reason.
        reason: &'static str,
    },
    /// The rig lacks what the procedure moves.
    #[error("this rig has no {device}.{what}: the procedure needs it; add it to [axes] of the rig's file")]
    NoAxis {
        /// Whose.
        device: Device,
        /// Which.
        what: &'static str,
    },
    /// A position that cannot be trusted.
    #[error(
        "the position of {0} is not to be trusted since its last stop: home it, or check it, before tips are sent anywhere"
    )]
    Untrusted(AxisName),
    /// There is no room for the moves.
    #[error("{device} has no room to move here: {why}; move it to where it can go at least {least_um:.0} µm each way")]
    NoRoom {
        /// What should move.
        device: Device,
        /// What is in the way.
        why: String,
        /// How far it should be able to go, µm.
        least_um: f64,
    },
    /// The point does not follow the axes as a point in focus does.
    #[error("{what}")]
    Implausible {
        /// What was seen and what to do.
        what: String,
    },
    /// Too few places gave a sample.
    #[error(
        "only {got} of {wanted} places gave a sample ({passed} did not), which is too few; the last reason: {last}"
    )]
    Lost {
        /// Samples taken.
        got: usize,
        /// Samples wanted.
        wanted: usize,
        /// Places passed over.
        passed: usize,
        /// What went wrong last.
        last: String,
    },
    /// The pipette's manipulator has obstacles around it that cannot be checked.
    #[error(
        "where the tip of {0} is cannot be known: it is not registered, and obstacles are there; register it, or move it by 'parfocal move' and by eye"
    )]
    TipUnknown(ManipulatorNumber),
    /// No marker says where the manipulator is.
    #[error(
        "{0} has no coarse registration: photograph the markers with 'parfocal calibrate coarse --pairs DIR --rig FILE', or bring its tip into view by hand"
    )]
    Uncoarse(ManipulatorNumber),
    /// The search ended without the tip.
    #[error(
        "the tip of {number} is nowhere within {within_um:.0} µm of where its coarse registration has it: was it moved by hand since, or is the pipette broken or missing? photograph the markers anew with 'parfocal calibrate coarse --rig FILE', or bring it into view by hand"
    )]
    Nowhere {
        /// Whose tip.
        number: ManipulatorNumber,
        /// How far was looked in each direction, µm.
        within_um: f64,
    },
    /// The objective shows too little to search with.
    #[error(
        "the tip is known to {error_um:.0} µm only, which takes {looks} looks through {objective}: name a weaker objective first, as in --through 4x,40x"
    )]
    SmallField {
        /// The objective.
        objective: String,
        /// Looks that the search would take.
        looks: usize,
        /// Standard deviation of the tip's place, µm.
        error_um: f64,
    },
    /// The sample file.
    #[error("{}: cannot be written: {reason}", path.display())]
    Record {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// The person did not go on.
    #[error("the objective was not changed: {0}")]
    NotChanged(String),
}

impl ProcedureError {
    /// Whether another place may still give a sample.
    pub fn is_local(&self) -> bool {
        match self {
            Self::NotFound(why) => !why.is_final(),
            Self::NotFocused { .. } | Self::Collision(_) => true,
            Self::Stage(StageError::BeyondLimit { .. }) => true,
            _ => false,
        }
    }
}
