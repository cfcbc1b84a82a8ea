//! `parfocal calibrate camera`.

use super::{Output, Solving, folder, rows};
use crate::cmd::connection::Connection;
use crate::cmd::live::{LiveArguments, PointArguments, Room};
use anyhow::Context;
use clap::Args;
use parfocal::calibration::camera::{CameraFit, fit};
use parfocal::calibration::chain::{ChainError, Sensor};
use parfocal::calibration::report;
use parfocal::procedure::{self, CameraPlan, Purpose};
use parfocal::rig::{self, CameraCalibration, Moves, Rig};

/// Options of `parfocal calibrate camera`.
#[derive(Debug, Args)]
pub struct Camera {
    #[command(flatten)]
    solving: Solving,
    #[command(flatten)]
    live: LiveArguments,
    #[command(flatten)]
    point: PointArguments,
    /// What moved: the objective with the camera, or the stage under a point fixed on the sample [default: the rig's]
    #[arg(long, value_name = "objective|stage", value_parser = moves)]
    moves: Option<Moves>,
    /// The objective it was taken with [default: the rig's in use]
    #[arg(long, value_name = "NAME")]
    objective: Option<String>,
}

fn moves(text: &str) -> Result<Moves, String> {
    match text {
        "objective" => Ok(Moves::Objective),
        "stage" => Ok(Moves::Stage),
        _ => Err(format!("'{text}' is neither objective nor stage")),
    }
}

impl Camera {
    /// # Errors
    /// What stopped it, naming the row or key.
    pub fn run(mut self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        if self.solving.samples.is_none() {
            let room = Room::new(&self.live, self.solving.rig.as_deref(), connection, self.solving.seed)?;
            self.solving.ready()?;
            if self.solving.dry_run {
                return super::moves::microscope(&room, self.live.places(), self.solving.report.as_deref(), out);
            }
            // Said before anything moves.
            self.objective(&room.known()?)?;
            let plan = CameraPlan {
                subject: self.point.subject()?,
                places: self.live.places(),
                seed: self.solving.seed,
                focus_within_um: Some(self.live.focus_within_um()),
            };
            let recorded = room.run("camera", Purpose::Microscope, &mut |live, finder, recorder, _| {
                procedure::camera(live, finder, &plan, recorder).map(|_| ())
            })?;
            self.solving.take(recorded);
        }
        let mut rig = self.solving.rig()?;
        let sensor = self.solving.sensor(rig.as_ref())?;
        let samples = self.solving.table()?.camera()?;
        let of_rig = rig.as_ref().and_then(|rig| rig.axis("scope.x".parse().ok()?)?.moves);
        let moves = self.moves.or(of_rig).unwrap_or(Moves::Objective);
        let fit = fit(&samples, sensor, moves, &self.solving.options())?;
        let report = report::camera(&fit, sensor);
        if let Some(path) = &self.solving.report {
            folder(path)?;
            report.write(path)?;
        }
        let saved = match &mut rig {
            Some(rig) => {
                self.put(rig, &fit, sensor)?;
                self.solving.save(rig)?
            }
            None => String::new(),
        };
        out.result(&format!("{}\n{saved}", report.text()), &self.json(&fit, &report))
    }

    /// The objective that the samples are taken with, and its α, which divides the matrix.
    fn objective(&self, rig: &Rig) -> anyhow::Result<(Option<String>, f64)> {
        let name = self.objective.clone().or_else(|| rig.contents().objective_in_use.clone());
        if rig.contents().objectives.is_empty() {
            return Ok((name, 1.0));
        }
        let name = name.ok_or(ChainError::NoObjective)?;
        let objective = rig.contents().objectives.get(&name).with_context(|| {
            let known: Vec<_> = rig.contents().objectives.keys().map(String::as_str).collect();
            format!("objective '{name}' is not in the rig's file; it has: {}", known.join(", "))
        })?;
        let zoom = rig.contents().zoom_in_use.unwrap_or(1.0);
        let alpha = match objective.zooms.iter().find(|z| z.zoom == zoom) {
            Some(zoom) => zoom.alpha,
            None if objective.default => 1.0,
            None => anyhow::bail!(
                "the camera's matrix is kept for the default objective, and '{name}' is not calibrated against it: \
                 calibrate the camera with the default one, then 'parfocal calibrate objective'"
            ),
        };
        Ok((Some(name), alpha))
    }

    /// Puts A, which is of the default objective, in the rig.
    fn put(&self, rig: &mut Rig, fit: &CameraFit, sensor: Sensor) -> anyhow::Result<()> {
        let (name, alpha) = self.objective(rig)?;
        let a = fit.matrix_um_per_px / alpha;
        let camera = rig.contents_mut().camera.get_or_insert(rig::Camera {
            width_px: sensor.width_px,
            height_px: sensor.height_px,
            crop_px: None,
            binning: 1,
            calibration: None,
            latency: None,
        });
        camera.calibration = Some(CameraCalibration {
            matrix_um_per_px: [[a[(0, 0)], a[(0, 1)]], [a[(1, 0)], a[(1, 1)]]],
            objective: name,
            record: self.solving.record(&fit.solution, None),
        });
        Ok(())
    }

    fn json(&self, fit: &CameraFit, report: &report::Report) -> serde_json::Value {
        let (x, y) = fit.pixel_um();
        serde_json::json!({
            "matrix_um_per_px": rows(&fit.matrix_um_per_px),
            "pixel_um": { "x": x, "y": y },
            "rotation_deg": fit.rotation_deg(),
            "skew_deg": fit.skew_deg(),
            "mirrored": fit.mirrored(),
            "rms_um": fit.solution.rms(),
            "rms_px": fit.rms_px(),
            "max_um": fit.solution.max(),
            "inliers": fit.solution.inliers,
            "standard_errors": fit.standard_errors.map(|e| rows(&e)),
            "tolerance_um": fit.solution.tolerance,
            "seed": self.solving.seed,
            "draws": fit.solution.draws,
            "verdict": report.verdict,
        })
    }
}
