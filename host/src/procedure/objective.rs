//! Objectives, live: the same point seen through each, at places drawn uniformly in the picture, in focus every time.

use super::camera::sample;
use super::error::ProcedureError;
use super::guard::{Pose, moves_sample};
use super::live::{LiveRig, Progress};
use super::point::{PointFinder, Subject};
use super::record::{Recorder, Sample};
use super::survey::{Survey, survey};
use crate::rig::{AxisName, Coordinate, Device, Rig};
use nalgebra::Vector3;

/// What to do.
#[derive(Clone, Debug)]
pub struct ObjectivePlan {
    /// The default objective first, then those to calibrate.
    pub names: Vec<String>,
    /// A point that stays in ref.
    pub subject: Subject,
    /// Places to see it from through each, besides three first ones.
    pub places: usize,
    /// Of the draws.
    pub seed: u64,
    /// How far from the present height the point's focus may be after a change of objective, µm.
    pub focus_within_um: f64,
}

/// P_M as the point sees it: a stage that moves the sample moves it the other way.
fn microscope(rig: &Rig, pose: &Pose) -> Vector3<f64> {
    Vector3::from(Coordinate::ALL.map(|coordinate| {
        let name = AxisName { device: Device::Scope, coordinate };
        let sign = if moves_sample(rig, name) { -1.0 } else { 1.0 };
        sign * pose.axis(name).0
    }))
}

/// Records the samples of objectives; solve them with [`crate::calibration::objective::fit`]. `change` puts an objective
/// into the light path: it asks a person, or turns a turret; it is told the objective's name.
///
/// # Errors
/// [`ProcedureError`]; what was recorded until then stays recorded. Which objective is in the light path then,
/// [`super::Guard::objective`] says.
pub fn objectives(
    live: &mut LiveRig<'_>,
    finder: &mut dyn PointFinder,
    plan: &ObjectivePlan,
    change: &mut dyn FnMut(&str) -> Result<(), String>,
    recorder: &mut Recorder,
) -> Result<(), ProcedureError> {
    for name in &plan.names {
        if live.guard.objective() != Some(name) {
            change(name).map_err(ProcedureError::NotChanged)?;
            live.guard.set_objective(name);
        }
        live.tell(Progress::Begins(format!(
            "Looking at {} through {name}, from {} places.",
            plan.subject,
            plan.places + 3
        )));
        let around = Survey {
            subject: plan.subject.clone(),
            places: plan.places,
            seed: plan.seed,
            focus_within_um: Some(plan.focus_within_um),
        };
        survey(live, finder, &around, &mut |live, sighting| {
            let mic_um = microscope(live.rig(), &sighting.pose);
            let kept: Sample = sample(live, &plan.subject, &sighting.pose, &sighting.seen, mic_um);
            recorder.keep(kept)
        })?;
    }
    Ok(())
}
