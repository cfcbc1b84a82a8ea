//! The whole run: camera, then every manipulator with its pipette.

use super::bring::{Turret, bring};
use super::error::AutoError;
use super::eyes::Eyes;
use super::records::Records;
use super::{camera, manipulator};
use crate::calibration::robust::Solution;
use crate::calibration::statistics;
use crate::frames::camera::Camera;
use crate::procedure::{Focuser, LiveRig, Parts, Progress};
use crate::rig::{self, CameraCalibration, ManipulatorNumber, Record, Registration, Rig};
use crate::stage::Stage;
use std::path::PathBuf;

/// What to do.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Which manipulators, in this order.
    pub manipulators: Vec<ManipulatorNumber>,
    /// Of all draws and solvers.
    pub seed: u64,
    /// Standard error asked of every map, at its worst place in view, µm in one coordinate.
    pub error_um: f64,
    /// How far from the present height tips are looked for at first, µm.
    pub reach_um: f64,
    /// How far from a predicted height a tip's focus may be, µm.
    pub focus_um: f64,
    /// How far the places spread in depth, µm.
    pub depth_um: f64,
    /// Places in a row that may give no sample.
    pub patience: usize,
    /// Where samples are kept; in memory only without it.
    pub folder: Option<PathBuf>,
}

impl Plan {
    /// A plan for a 40x objective.
    pub fn new(manipulators: Vec<ManipulatorNumber>, seed: u64) -> Self {
        Self {
            manipulators,
            seed,
            error_um: 0.3,
            reach_um: 60.0,
            focus_um: 20.0,
            depth_um: 30.0,
            patience: 6,
            folder: None,
        }
    }

    /// The camera's share: its errors are in every manipulator's.
    pub(super) fn camera_error_um(&self) -> f64 {
        0.5 * self.error_um
    }
}

/// What a run works with.
pub struct Work<'a> {
    /// The axes.
    pub stage: &'a mut Stage,
    /// The camera; its clock is the stage's.
    pub camera: &'a mut dyn Camera,
    /// How the microscope is brought into focus.
    pub focuser: &'a mut dyn Focuser,
    /// What sees tips.
    pub eyes: &'a mut dyn Eyes,
    /// Asked all the while; false stops what moves and ends the run.
    pub keep_on: &'a dyn Fn() -> bool,
    /// Told how it goes.
    pub progress: &'a mut dyn FnMut(Progress),
    /// How tips come into view first; without it they are there, brought by a person.
    pub turret: Option<Turret<'a>>,
}

/// What came of a run.
#[derive(Debug)]
pub struct Calibrated {
    /// What was calibrated, in words, with its error.
    pub done: Vec<String>,
    /// What was not, and why.
    pub missing: Vec<(ManipulatorNumber, AutoError)>,
}

/// A live rig for one part of the run, and its eyes.
pub(super) fn live<'w>(work: &'w mut Work<'_>, rig: &'w Rig) -> Result<(LiveRig<'w>, &'w mut dyn Eyes), AutoError> {
    let live = LiveRig::new(Parts {
        stage: work.stage,
        camera: work.camera,
        focuser: work.focuser,
        rig,
        keep_on: work.keep_on,
        progress: work.progress,
    })?;
    Ok((live, work.eyes))
}

/// Calibrates the camera and every manipulator of the plan. `save` is given the rig after each, so that nothing found is
/// lost. A manipulator that cannot be calibrated does not keep the others from it.
///
/// # Errors
/// The camera could not be calibrated, the run was interrupted, or a board, the camera or a file is gone.
pub fn calibrate(
    work: &mut Work<'_>,
    rig: &mut Rig,
    plan: &Plan,
    date: &dyn Fn() -> String,
    save: &mut dyn FnMut(&mut Rig) -> Result<(), AutoError>,
) -> Result<Calibrated, AutoError> {
    let records = Records::new(plan.folder.as_deref(), plan.seed)?;
    let mut calibrated = Calibrated { done: Vec::new(), missing: Vec::new() };
    let mut waiting = plan.manipulators.iter().copied();
    let first = next_in_view(work, rig, &mut waiting, date, save, &mut calibrated)?;
    if first.is_none() && !calibrated.missing.is_empty() {
        return Ok(calibrated);
    }
    let found = camera::calibrate(work, rig, plan, &records)?;
    put_camera(rig, &found, plan, date())?;
    save(rig)?;
    let (x, y) = found.fit.pixel_um();
    calibrated.done.push(format!(
        "camera: {x:.4} x {y:.4} µm a pixel, {:.3} µm rms over {} of {} samples",
        found.fit.solution.rms(),
        found.fit.solution.chosen().len(),
        found.fit.image_px.len()
    ));
    let mut next = first;
    while let Some(n) = next {
        match manipulator::calibrate(work, rig, plan, n, &records) {
            Ok(found) => {
                let solution = &found.fit.solution;
                rig.set_registration(
                    n,
                    Registration {
                        model: "affine".into(),
                        matrix: found.fit.transform().to_rows(),
                        record: record(solution, plan.seed, found.samples.clone(), date()),
                    },
                );
                let mut pipette = "direction not known".to_owned();
                if let Some(direction) = &found.direction {
                    let (descent_deg, azimuth_deg) = (direction.fit.descent_deg, direction.fit.azimuth_deg);
                    pipette = format!("pipette {descent_deg:.1}° down (by its {})", direction.source);
                    let source = direction.source.into();
                    rig.set_pipette(n, rig::Pipette { descent_deg, azimuth_deg, source, date: date() });
                }
                save(rig)?;
                calibrated.done.push(format!(
                    "{n}: {:.2} µm rms over {} of {} samples, {pipette}",
                    solution.rms(),
                    solution.chosen().len(),
                    solution.inliers.len()
                ));
            }
            Err(error) => calibrated.lost(work, n, error)?,
        }
        next = next_in_view(work, rig, &mut waiting, date, save, &mut calibrated)?;
    }
    Ok(calibrated)
}

impl Calibrated {
    /// Goes on without a manipulator.
    fn lost(&mut self, work: &mut Work<'_>, n: ManipulatorNumber, error: AutoError) -> Result<(), AutoError> {
        if !error.is_of_one_manipulator() {
            return Err(error);
        }
        (work.progress)(Progress::Warning(format!("{n} is not calibrated: {error}")));
        self.missing.push((n, error));
        Ok(())
    }
}

/// The next manipulator whose tip comes into view.
fn next_in_view(
    work: &mut Work<'_>,
    rig: &mut Rig,
    waiting: &mut dyn Iterator<Item = ManipulatorNumber>,
    date: &dyn Fn() -> String,
    save: &mut dyn FnMut(&mut Rig) -> Result<(), AutoError>,
    calibrated: &mut Calibrated,
) -> Result<Option<ManipulatorNumber>, AutoError> {
    for n in waiting {
        match bring(work, rig, n, date(), save) {
            Ok(()) => return Ok(Some(n)),
            Err(error) => calibrated.lost(work, n, error)?,
        }
    }
    Ok(None)
}

fn put_camera(rig: &mut Rig, found: &camera::Found, plan: &Plan, date: String) -> Result<(), AutoError> {
    let contents = rig.contents();
    let name = contents.objective_in_use.clone();
    let zoom = contents.zoom_in_use.unwrap_or(1.0);
    // A is kept for the default objective.
    let of = name.as_ref().and_then(|name| contents.objectives.get(name));
    let alpha = of.and_then(|o| o.zooms.iter().find(|z| z.zoom == zoom)).map_or(1.0, |z| z.alpha);
    let a = found.fit.matrix_um_per_px / alpha;
    rig.set_camera_calibration(CameraCalibration {
        matrix_um_per_px: [[a[(0, 0)], a[(0, 1)]], [a[(1, 0)], a[(1, 1)]]],
        objective: name,
        record: record(&found.fit.solution, plan.seed, found.samples.clone(), date),
    })?;
    Ok(())
}

fn record<const D: usize>(solution: &Solution<D>, seed: u64, samples: String, date: String) -> Record {
    Record {
        date,
        seed,
        samples,
        tolerance_um: solution.tolerance,
        rms_um: solution.rms(),
        residuals_um: solution.residuals.iter().map(|r| (r.norm() * 1e4).round() / 1e4).collect(),
        rejected: (0..solution.inliers.len()).filter(|&i| !solution.inliers[i]).map(|i| i + 1).collect(),
        certainty: statistics::certainty(solution),
    }
}
