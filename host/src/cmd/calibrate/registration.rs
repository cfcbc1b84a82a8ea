//! `parfocal calibrate registration`.

use super::{Output, Solving, folder, matrix, rows};
use crate::cmd::connection::Connection;
use crate::cmd::live::{LiveArguments, Room};
use anyhow::Context;
use clap::Args;
use nalgebra::{Matrix2, Vector3};
use parfocal::calibration::chain::Chain;
use parfocal::calibration::registration::{RegistrationFit, fit};
use parfocal::calibration::report;
use parfocal::calibration::robust::{Model, ScalePrior};
use parfocal::calibration::samples::Seen;
use parfocal::procedure::{self, Purpose, RegistrationPlan};
use parfocal::rig::{self, ManipulatorNumber, Rig};

/// Options of `parfocal calibrate registration`.
#[derive(Debug, Args)]
pub struct Registration {
    #[command(flatten)]
    solving: Solving,
    #[command(flatten)]
    live: LiveArguments,
    /// How far the places of a live registration spread in depth, µm
    #[arg(long, value_name = "UM", default_value_t = 40.0, value_parser = super::positive)]
    depth_um: f64,
    /// affine, similarity or rigid
    #[arg(long, default_value = "affine", value_parser = model)]
    model: Model,
    /// The manipulator whose registration in the rig this becomes
    #[arg(long, value_name = "N")]
    manipulator: Option<ManipulatorNumber>,
    /// The camera's matrix with the objective in use, a,b,c,d in µm a px, row after row [default: the rig's]
    #[arg(long, value_name = "a,b,c,d", value_parser = matrix, allow_hyphen_values = true)]
    camera_matrix: Option<Matrix2<f64>>,
    /// Expected length of the manipulator's axes, µm a µm; breaks ties
    #[arg(long, value_name = "SCALE", default_value_t = 1.0, value_parser = super::positive)]
    axis_scale: f64,
    /// Its standard deviation
    #[arg(long, value_name = "SD", default_value_t = 0.05, value_parser = super::positive)]
    axis_scale_sd: f64,
    /// Expect nothing of the axes' lengths
    #[arg(long, conflicts_with_all = ["axis_scale", "axis_scale_sd"])]
    no_axis_scale: bool,
}

fn model(text: &str) -> Result<Model, String> {
    let known = [Model::Affine, Model::Similarity, Model::Rigid];
    known.into_iter().find(|m| m.name() == text).ok_or_else(|| format!("'{text}' is none of affine, similarity, rigid"))
}

impl Registration {
    /// # Errors
    /// What stopped it, naming the row or key.
    pub fn run(mut self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        if self.solving.samples.is_none() {
            let room = Room::new(&self.live, self.solving.rig.as_deref(), connection, self.solving.seed)?;
            self.solving.ready()?;
            let manipulator = self.manipulator.context("say which manipulator to register: --manipulator N")?;
            let plan = RegistrationPlan {
                manipulator,
                places: self.live.places(),
                seed: self.solving.seed,
                depth_um: self.depth_um,
                focus_within_um: self.live.focus_within_um(),
            };
            if self.solving.dry_run {
                return super::moves::registration(&room, &plan, self.solving.report.as_deref(), out);
            }
            let name = format!("registration {manipulator}");
            let recorded = room.run(&name, Purpose::Registration, &mut |live, finder, recorder, _| {
                procedure::registration(live, finder, &plan, recorder)
            })?;
            self.solving.take(recorded);
        }
        let mut rig = self.solving.rig()?;
        let samples = self.solving.table()?.registration()?;
        let in_pixels = samples.iter().any(|s| matches!(s.seen, Seen::Picture { .. }));
        let chain = if in_pixels { self.chain(rig.as_ref())? } else { None };
        let prior = ScalePrior { scale: self.axis_scale, deviation: self.axis_scale_sd };
        let prior = (!self.no_axis_scale).then_some(prior);
        let fit = fit(&samples, chain.as_ref(), self.model, prior, &self.solving.options())?;
        let report = report::registration(&fit);
        if let Some(path) = &self.solving.report {
            folder(path)?;
            report.write(path)?;
        }
        let saved = match (&mut rig, self.manipulator) {
            (Some(rig), Some(number)) => {
                let transform = fit.transform();
                let record = self.solving.record(&fit.solution, None);
                let model = fit.model.name().into();
                rig.set_registration(number, rig::Registration { model, matrix: transform.to_rows(), record });
                self.solving.save(rig)?
            }
            (Some(_), None) => "Not put in force: say whose it is with --manipulator N.\n".into(),
            (None, _) => String::new(),
        };
        out.result(&format!("{}\n{saved}", report.text()), &self.json(&fit, &report))
    }

    /// The chain from pixels to ref: said, or the rig's at the objective in use.
    fn chain(&self, rig: Option<&Rig>) -> anyhow::Result<Option<Chain>> {
        match (&self.camera_matrix, rig) {
            (Some(a), _) => Ok(Chain::new(self.solving.sensor(rig)?, a, 1.0, Vector3::zeros())),
            (None, Some(rig)) => Ok(Some(Chain::of(rig)?)),
            (None, None) => Ok(None),
        }
    }

    fn json(&self, fit: &RegistrationFit, report: &report::Report) -> serde_json::Value {
        let [xy, yz, zx] = fit.axis_angles_deg();
        serde_json::json!({
            "model": fit.model.name(),
            "matrix": fit.transform().to_rows(),
            "axis_angles_deg": { "xy": xy, "yz": yz, "zx": zx },
            "axis_scales": fit.axis_scales(),
            "mirrored": fit.mirrored(),
            "rms_um": fit.solution.rms(),
            "max_um": fit.solution.max(),
            "leave_one_out_max_um": fit.leave_one_out_max_um(),
            "inliers": fit.solution.inliers,
            "standard_errors": fit.standard_errors.map(|e| rows(&e.linear)),
            "tolerance_um": fit.solution.tolerance,
            "seed": self.solving.seed,
            "draws": fit.solution.draws,
            "verdict": report.verdict,
        })
    }
}
