//! `parfocal calibrate pipette`.

use super::{Output, now};
use crate::cmd::connection::Connection;
use crate::cmd::live::{LiveArguments, Room};
use anyhow::Context;
use clap::{ArgGroup, Args};
use nalgebra::Matrix3;
use parfocal::calibration::pipette::{PipetteFit, from_axis, from_shank};
use parfocal::calibration::samples::Table;
use parfocal::procedure::{self, Purpose, ShankPlan};
use parfocal::rig::{self, ManipulatorNumber, Rig, TipOffset};
use std::path::PathBuf;

/// Options of `parfocal calibrate pipette`.
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("from").args(["samples", "descent_deg", "axis", "tip_offset_um"])))]
pub struct Pipette {
    /// Points in focus along the shank, the tip first: CSV with ref_x_um,ref_y_um,ref_z_um
    #[arg(long, value_name = "FILE.csv")]
    samples: Option<PathBuf>,
    /// Descent read off the protractor: how steeply an advance goes down
    #[arg(long, value_name = "DEG", requires = "azimuth_deg", allow_hyphen_values = true)]
    descent_deg: Option<f64>,
    /// Azimuth: where an advance goes in ref, from x towards y
    #[arg(long, value_name = "DEG", requires = "descent_deg", allow_hyphen_values = true)]
    azimuth_deg: Option<f64>,
    /// The registered axis that the pipette is mounted along: x, y or z
    #[arg(long, value_name = "AXIS", value_parser = ["x", "y", "z"], requires_all = ["rig", "manipulator"])]
    axis: Option<String>,
    /// Where the tip of a new pipette is in ref, from where the registered one was
    #[arg(long, value_name = "x,y,z", value_parser = three, requires_all = ["rig", "manipulator"], allow_hyphen_values = true)]
    tip_offset_um: Option<[f64; 3]>,
    #[command(flatten)]
    live: LiveArguments,
    /// Live: from one place on the shank to the next, px
    #[arg(long, value_name = "PX", default_value_t = 40.0, value_parser = super::positive)]
    step_px: f64,
    /// Seed of everything random
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Live: only say what would be done
    #[arg(long)]
    dry_run: bool,
    /// The rig, where the result is put in force
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Whose pipette
    #[arg(long, value_name = "N")]
    manipulator: Option<ManipulatorNumber>,
}

fn three(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> =
        text.split(',').filter_map(|s| s.trim().parse().ok()).filter(|v: &f64| v.is_finite()).collect();
    numbers.try_into().map_err(|_| format!("'{text}' is not x,y,z in µm"))
}

impl Pipette {
    /// # Errors
    /// What stopped it, naming the row or key.
    pub fn run(mut self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let told = self.descent_deg.is_some() || self.axis.is_some() || self.tip_offset_um.is_some();
        if self.samples.is_none() && !told {
            let room = Room::new(&self.live, self.rig.as_deref(), connection, self.seed)?;
            let manipulator = self.manipulator.context("say whose pipette to look at: --manipulator N")?;
            let plan = ShankPlan {
                manipulator,
                places: self.live.places(),
                step_px: self.step_px,
                focus_within_um: self.live.focus_within_um(),
            };
            if self.dry_run {
                let text = format!(
                    "scope.z would focus on the tip of {manipulator}, then on {} places {} px apart up its shank, within {} µm each.",
                    plan.places, plan.step_px, plan.focus_within_um
                );
                return out.result(&text, &serde_json::json!({ "places": plan.places, "step_px": plan.step_px }));
            }
            let name = format!("pipette {manipulator}");
            let recorded = room.run(&name, Purpose::Shank, &mut |live, finder, recorder, _| {
                procedure::shank(live, finder, &plan, recorder)
            })?;
            self.samples = Some(recorded.samples);
        }
        let mut rig = self.rig.as_deref().map(Rig::load).transpose()?;
        if let Some(offset_um) = self.tip_offset_um {
            return self.tip_offset(rig, offset_um, out);
        }
        let (descent_deg, azimuth_deg, rms_um, source) = self.angles(rig.as_ref())?;
        let mut text = format!(
            "The pipette descends {descent_deg:.2}° and advances towards {azimuth_deg:.2}° (from x to y), by the {source}.\n"
        );
        let json = serde_json::json!({
            "descent_deg": descent_deg, "azimuth_deg": azimuth_deg, "rms_um": rms_um, "source": source,
        });
        if let Some(rig) = &mut rig {
            let number = self.manipulator.context("say whose pipette it is: --manipulator N")?;
            rig.set_pipette(number, rig::Pipette { descent_deg, azimuth_deg, source: source.into(), date: now() });
            text.push_str(&self.save(rig)?);
        }
        out.result(&text, &json)
    }

    /// Descent, azimuth, rms and where they come from.
    fn angles(&self, rig: Option<&Rig>) -> anyhow::Result<(f64, f64, f64, &'static str)> {
        if let (Some(descent), Some(azimuth)) = (self.descent_deg, self.azimuth_deg) {
            anyhow::ensure!((-90.0..=90.0).contains(&descent), "--descent-deg {descent}: must be -90 to 90");
            anyhow::ensure!((-360.0..=360.0).contains(&azimuth), "--azimuth-deg {azimuth}: must be -360 to 360");
            return Ok((descent, azimuth, 0.0, "protractor"));
        }
        let (fit, source): (PipetteFit, _) = if let Some(samples) = &self.samples {
            (from_shank(&Table::read(samples)?.shank()?)?, "shank")
        } else {
            let number = self.manipulator.context("say whose axis it is: --manipulator N")?;
            let registration = rig.and_then(|rig| rig.contents().manipulators.get(&number)?.registration.as_ref());
            let rows = registration.with_context(|| format!("{number} is not registered in the rig's file"))?.matrix;
            let axis = ["x", "y", "z"].into_iter().position(|a| Some(a) == self.axis.as_deref()).unwrap_or(0);
            (from_axis(&Matrix3::from_fn(|r, c| rows[r][c]), axis), "axis")
        };
        Ok((fit.descent_deg, fit.azimuth_deg, fit.rms_um, source))
    }

    fn tip_offset(&self, rig: Option<Rig>, offset_um: [f64; 3], out: Output) -> anyhow::Result<()> {
        let mut rig = rig.context("give --rig FILE")?;
        let number = self.manipulator.context("say whose tip it is: --manipulator N")?;
        let warning = rig.add_tip_offset(number, TipOffset { date: now(), offset_um })?.map(|w| w.to_string());
        if let Some(warning) = &warning {
            eprintln!("parfocal: {warning}");
        }
        let saved = self.save(&mut rig)?;
        let json = serde_json::json!({ "manipulator": number, "tip_offset_um": offset_um, "warning": warning });
        out.result(&format!("The tip of {number} is {offset_um:?} µm from the registered one.\n{saved}"), &json)
    }

    fn save(&self, rig: &mut Rig) -> anyhow::Result<String> {
        let Some(path) = &self.rig else { return Ok(String::new()) };
        rig.save(path)?;
        Ok(format!("In force in {}.\n", path.display()))
    }
}
