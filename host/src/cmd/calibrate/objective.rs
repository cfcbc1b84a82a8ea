//! `parfocal calibrate objective`.

use super::{Output, Solving, folder, matrix};
use crate::cmd::connection::Connection;
use crate::cmd::live::{Around, LiveArguments, PointArguments, Room};
use anyhow::{Context, bail};
use clap::Args;
use nalgebra::Matrix2;
use parfocal::calibration::objective::{ObjectiveFit, fit};
use parfocal::calibration::report;
use parfocal::calibration::samples::ObjectiveSample;
use parfocal::procedure::{self, ObjectivePlan, Purpose};
use parfocal::rig::{Rig, Zoom};
use std::io::{BufRead, Write};
use std::path::Path;

/// Options of `parfocal calibrate objective`.
#[derive(Debug, Args)]
pub struct Objective {
    #[command(flatten)]
    solving: Solving,
    #[command(flatten)]
    live: LiveArguments,
    #[command(flatten)]
    point: PointArguments,
    /// Objectives to look through, live [default: all of the rig's file]
    #[arg(long, value_name = "NAME,…", value_delimiter = ',', conflicts_with = "samples")]
    through: Vec<String>,
    /// The objective that defines α = 1 and κ = 0 [default: the rig's, or the first in the samples]
    #[arg(long, value_name = "NAME")]
    default: Option<String>,
    /// The microscope's zoom during the samples [default: the rig's, or 1]
    #[arg(long, value_parser = super::positive)]
    zoom: Option<f64>,
    /// The camera's matrix with the default objective, a,b,c,d in µm a px, row after row [default: the rig's]
    #[arg(long, value_name = "a,b,c,d", value_parser = matrix, allow_hyphen_values = true)]
    camera_matrix: Option<Matrix2<f64>>,
}

impl Objective {
    /// # Errors
    /// What stopped it, naming the row or key.
    pub fn run(mut self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        if self.solving.samples.is_none() {
            let room = Room::new(&self.live, self.solving.rig.as_deref(), connection, self.solving.seed)?;
            self.solving.ready()?;
            let plan = self.plan(&room)?;
            if self.solving.dry_run {
                return super::moves::microscope(&room, plan.places, self.solving.report.as_deref(), out);
            }
            let path = room.rig;
            let recorded = room.run("objective", Purpose::Microscope, &mut |live, finder, recorder, around| {
                procedure::objectives(live, finder, &plan, &mut |name| change(path, name, around), recorder)
            })?;
            self.solving.take(recorded);
        }
        let mut rig = self.solving.rig()?;
        let sensor = self.solving.sensor(rig.as_ref())?;
        let samples = self.solving.table()?.objective()?;
        let default = self.default_name(rig.as_ref(), &samples)?;
        let a = self.matrix(rig.as_ref())?;
        let fits = fit(&samples, &default, sensor, &a, &self.solving.options())?;
        let mut text = String::new();
        let mut json = serde_json::Map::new();
        for fit in &fits {
            let report = report::objective(fit, &default);
            if let Some(path) = &self.solving.report {
                // One objective a folder; names like 40x/0.8 are no folders' names.
                let plain: String = fit.name.chars().map(|c| if c.is_alphanumeric() { c } else { '_' }).collect();
                let path = if fits.len() == 1 { path.clone() } else { path.join(plain) };
                folder(&path)?;
                report.write(&path)?;
            }
            text.push_str(&report.text());
            text.push('\n');
            json.insert(fit.name.clone(), entry(fit, &report));
        }
        if let Some(rig) = &mut rig {
            let zoom = self.zoom.or(rig.contents().zoom_in_use).unwrap_or(1.0);
            rig.contents_mut().objectives.entry(default.clone()).or_default().default = true;
            for fit in &fits {
                let record = Some(self.solving.record(&fit.solution, Some(&fit.rows)));
                rig.set_zoom(&fit.name, Zoom { zoom, alpha: fit.alpha, kappa_um: fit.kappa_um.into(), record });
            }
            text.push_str(&self.solving.save(rig)?);
        }
        let json = serde_json::json!({ "default": default, "objectives": json, "seed": self.solving.seed });
        out.result(&text, &json)
    }

    /// The default objective and those to calibrate against it, as the rig's file has them.
    fn plan(&self, room: &Room<'_>) -> anyhow::Result<ObjectivePlan> {
        let rig = room.known()?;
        self.matrix(Some(&rig))?;
        let default = self.default_name(Some(&rig), &[])?;
        let known: Vec<String> = rig.contents().objectives.keys().cloned().collect();
        if let Some(unknown) = self.through.iter().chain([&default]).find(|name| !known.contains(name)) {
            bail!("objective '{unknown}' is not in the rig's file; it has: {}", known.join(", "));
        }
        let others = if self.through.is_empty() { known } else { self.through.clone() };
        let mut names = vec![default.clone()];
        names.extend(others.into_iter().filter(|name| *name != default));
        if names.len() < 2 {
            bail!("the rig's file has no objective besides '{default}': add one with 'parfocal objective NAME --new'");
        }
        Ok(ObjectivePlan {
            names,
            subject: self.point.subject()?,
            places: self.live.places(),
            seed: self.solving.seed,
            focus_within_um: self.live.focus_within_um(),
        })
    }

    fn default_name(&self, rig: Option<&Rig>, samples: &[ObjectiveSample]) -> anyhow::Result<String> {
        let of_rig = rig.and_then(|rig| rig.contents().objectives.iter().find(|(_, o)| o.default));
        let first = samples.first().map(|s| &s.objective);
        let name = self.default.as_ref().or(of_rig.map(|(name, _)| name)).or(first);
        name.cloned().context("there are no samples")
    }

    fn matrix(&self, rig: Option<&Rig>) -> anyhow::Result<Matrix2<f64>> {
        let of_rig = rig.and_then(|rig| rig.contents().camera.as_ref()?.calibration.as_ref());
        let of_rig = of_rig.map(|c| Matrix2::from_fn(|r, k| c.matrix_um_per_px[r][k]));
        self.camera_matrix.or(of_rig).context(
            "samples in pixels need the camera: give --rig FILE with a calibrated camera, or --camera-matrix a,b,c,d",
        )
    }
}

/// Puts an objective into the light path. The rig's file says so at once, whatever becomes of the calibration.
pub(super) fn change(path: &Path, name: &str, around: &Around) -> Result<(), String> {
    turn(name, around)?;
    let mut rig = Rig::load(path).map_err(|e| e.to_string())?;
    rig.set_objective_in_use(Some(name)).map_err(|e| e.to_string())?;
    rig.save(path).map_err(|e| e.to_string())
}

/// Turns the simulated turret, or asks a person.
pub fn turn(name: &str, around: &Around) -> Result<(), String> {
    match &around.simulated {
        Some(rig) => rig.set_objective(name),
        None => {
            eprint!("Put objective {name} into the light path, the point in view, then press Enter ('q' ends): ");
            std::io::stderr().flush().ok();
            let mut line = String::new();
            let read = std::io::stdin().lock().read_line(&mut line).map_err(|e| e.to_string())?;
            if read == 0 || line.trim() == "q" {
                return Err("nobody said that it was".into());
            }
            Ok(())
        }
    }
}

fn entry(fit: &ObjectiveFit, report: &report::Report) -> serde_json::Value {
    let errors = fit.standard_errors.map(|e| serde_json::json!({ "alpha": e.linear[(0, 0)], "kappa_um": e.centre }));
    serde_json::json!({
        "alpha": fit.alpha,
        "kappa_um": [fit.kappa_um.x, fit.kappa_um.y, fit.kappa_um.z],
        "rms_um": fit.solution.rms(),
        "max_um": fit.solution.max(),
        "rows": fit.rows,
        "inliers": fit.solution.inliers,
        "standard_errors": errors,
        "tolerance_um": fit.solution.tolerance,
        "verdict": report.verdict,
    })
}
