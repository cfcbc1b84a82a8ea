//! The camera's live calibration: a fixed point, seen from many microscope positions.

use super::error::ProcedureError;
use super::guard::{Pose, moves_sample};
use super::live::{LiveRig, Progress, Seen};
use super::point::{PointFinder, Subject};
use super::record::{Recorder, Sample};
use super::survey::{Survey, survey};
use crate::rig::{AxisName, Coordinate, Device, Moves, Rig};
use nalgebra::Vector3;
use std::time::SystemTime;

/// What to do.
#[derive(Clone, Debug)]
pub struct CameraPlan {
    /// A point that stays in ref while the objective moves, or on the sample when the stage moves.
    pub subject: Subject,
    /// Places to see it from, besides three first ones.
    pub places: usize,
    /// Of the draws.
    pub seed: u64,
    /// Focus once at the start, its focus being within this of the present height.
    pub focus_within_um: Option<f64>,
}

/// What moves the picture: objective or stage.
///
/// # Errors
/// [`ProcedureError::Implausible`] when x moves one and y the other: one matrix cannot say that.
pub fn what_moves(rig: &Rig) -> Result<Moves, ProcedureError> {
    let axis = |coordinate| moves_sample(rig, AxisName { device: Device::Scope, coordinate });
    match (axis(Coordinate::X), axis(Coordinate::Y)) {
        (true, true) => Ok(Moves::Stage),
        (false, false) => Ok(Moves::Objective),
        _ => Err(ProcedureError::Implausible {
            what: "axes.scope.x.moves and axes.scope.y.moves differ: both must be \"objective\" or both \"stage\" for the camera's calibration".into(),
        }),
    }
}

/// Records the samples of a camera's calibration; solve them with [`crate::calibration::camera::fit`].
///
/// # Errors
/// [`ProcedureError`]; what was recorded until then stays recorded.
pub fn camera(
    live: &mut LiveRig<'_>,
    finder: &mut dyn PointFinder,
    plan: &CameraPlan,
    recorder: &mut Recorder,
) -> Result<Moves, ProcedureError> {
    let moves = what_moves(live.rig())?;
    if moves == Moves::Stage && matches!(plan.subject, Subject::Tip(_)) {
        return Err(ProcedureError::Implausible {
            what: "the stage moves the sample, not the tips: calibrate the camera with a point on the sample (--click --point NAME)".into(),
        });
    }
    live.tell(Progress::Begins(format!("Looking at {} from {} places.", plan.subject, plan.places + 3)));
    if let Some(reach) = plan.focus_within_um {
        live.first_focus_on(finder, &plan.subject, reach)?;
    }
    let around = Survey { subject: plan.subject.clone(), places: plan.places, seed: plan.seed, focus_within_um: None };
    survey(live, finder, &around, &mut |live, sighting| {
        let mic_um = sighting.pose.device(Device::Scope);
        recorder.keep(sample(live, &plan.subject, &sighting.pose, &sighting.seen, mic_um))
    })?;
    Ok(moves)
}

/// A sample of what was seen, without a manipulator.
pub(super) fn sample(live: &LiveRig<'_>, subject: &Subject, _pose: &Pose, seen: &Seen, mic_um: Vector3<f64>) -> Sample {
    Sample {
        time: SystemTime::now(),
        objective: live.guard.objective().map(Into::into),
        zoom: live.rig().contents().zoom_in_use.unwrap_or(1.0),
        point: subject.to_string(),
        man_um: None,
        mic_um,
        pixel: seen.pixel,
        ref_um: None,
        confidence: seen.found.confidence,
        by: seen.found.by,
    }
}
