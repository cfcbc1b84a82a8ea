//! `parfocal calibrate all --auto`.

use super::into_view::known;
use super::{Output, now, positive};
use crate::cmd::connection::Connection;
use crate::cmd::unattended::{Eyesight, Unattended};
use anyhow::{Context, bail};
use clap::Args;
use parfocal::autonomous::{AutoError, Calibrated, Plan, calibrate};
use parfocal::rig::{Device, ManipulatorNumber, Rig};
use serde_json::json;
use std::path::PathBuf;

/// Options of `parfocal calibrate all`.
#[derive(Debug, Args)]
pub struct All {
    /// With nobody at the microscope: the detector finds the tips
    #[arg(long, required = true)]
    auto: bool,
    /// Only these manipulators [default: all of the rig's]
    #[arg(long, value_name = "N")]
    manipulator: Vec<ManipulatorNumber>,
    /// Standard error asked of every map at its worst place in view, µm
    #[arg(long, value_name = "UM", default_value_t = 0.3, value_parser = positive)]
    error_um: f64,
    /// How far the places spread in depth, µm
    #[arg(long, value_name = "UM", default_value_t = 30.0, value_parser = positive)]
    depth_um: f64,
    /// The folder that samples are kept in; begun again with the same one, a run goes on from there [default: calibration, beside the rig's file]
    #[arg(long, value_name = "DIR")]
    record: Option<PathBuf>,
    /// Bring each tip into view first, where the coarse registration has it, through these objectives, the weakest first; with the last one all is
    /// calibrated
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    through: Vec<String>,
    #[command(flatten)]
    eyesight: Eyesight,
}

impl All {
    /// # Errors
    /// What stopped it; what is calibrated already is in the rig's file, and every sample in the folder.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let path = connection
            .rig
            .clone()
            .context("give --rig FILE, where the calibration is kept: 'parfocal setup' writes one")?;
        let mut rig = Rig::load(&path).with_context(|| path.display().to_string())?;
        let seed = connection.seed;
        let folder = self.record.clone().unwrap_or_else(|| path.with_file_name("calibration"));
        let manipulators = if self.manipulator.is_empty() { of_rig(&rig) } else { self.manipulator.clone() };
        if manipulators.is_empty() {
            bail!(
                "{}: has no manipulator in [axes]; 'parfocal calibrate camera' calibrates the camera alone",
                path.display()
            );
        }
        let plan = Plan {
            error_um: self.error_um,
            depth_um: self.depth_um,
            reach_um: self.eyesight.reach_um,
            folder: Some(folder.clone()),
            ..Plan::new(manipulators, seed)
        };
        known(&rig, &self.through)?;
        let mut unattended = Unattended::open(connection, &self.eyesight, &rig)?;
        let save = &mut |rig: &mut Rig| rig.save(&path).map_err(AutoError::from);
        let began = unattended.now();
        let done = unattended.work(&self.through, &mut |work| calibrate(work, &mut rig, &plan, &now, save));
        let minutes = (unattended.now() - began).as_secs_f64() / 60.0;
        unattended.close();
        let samples = format!("every sample is in {}; the same command goes on from there", folder.display());
        let Calibrated { done, missing } = done.with_context(|| samples.clone())?;
        let lost: Vec<String> = missing.iter().map(|(n, why)| format!("{n} is not calibrated: {why}")).collect();
        let text = if done.is_empty() {
            format!("Nothing was calibrated, and {} says what it said.\n", path.display())
        } else {
            let (file, folder) = (path.display(), folder.display());
            let done = done.join("\n");
            format!("{done}\n{minutes:.1} minutes of the rig's time. In force in {file}; samples in {folder}.\n")
        };
        let missing: Vec<_> =
            missing.iter().map(|(n, why)| json!({ "manipulator": n, "why": why.to_string() })).collect();
        out.result(&text, &json!({ "done": done, "missing": missing, "minutes": minutes, "samples": folder }))?;
        if !lost.is_empty() {
            bail!("{}; {samples}", lost.join("; "));
        }
        Ok(())
    }
}

fn of_rig(rig: &Rig) -> Vec<ManipulatorNumber> {
    let number = |device: &Device| match device {
        Device::Manipulator(n) => Some(*n),
        Device::Scope => None,
    };
    rig.contents().axes.keys().filter_map(number).collect()
}
