//! `parfocal tip recalibrate`.

use crate::cmd::Output;
use crate::cmd::connection::Connection;
use crate::cmd::unattended::{Eyesight, Unattended};
use anyhow::Context;
use clap::Args;
use parfocal::autonomous::{Plan, recalibrate};
use parfocal::rig::{ManipulatorNumber, Rig};
use serde_json::json;

/// Options of `parfocal tip recalibrate`.
#[derive(Debug, Args)]
pub struct Recalibrate {
    /// Whose pipette was changed
    #[arg(long, value_name = "N")]
    manipulator: ManipulatorNumber,
    /// Only say where the new tip is; the rig's file stays as it is
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    eyesight: Eyesight,
}

impl Recalibrate {
    /// # Errors
    /// What stopped it; the old tip stays in force then.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let path = connection.rig.clone().context("give --rig FILE: it holds the calibration")?;
        let mut rig = Rig::load(&path).with_context(|| path.display().to_string())?;
        let n = self.manipulator;
        let plan = Plan { reach_um: self.eyesight.reach_um, ..Plan::new(vec![n], connection.seed) };
        let mut unattended = Unattended::open(connection, &self.eyesight, &rig)?;
        let date = humantime::format_rfc3339_seconds(std::time::SystemTime::now()).to_string();
        let found = unattended.work(&[], &mut |work| recalibrate(work, &rig, n, &plan, date.clone()));
        unattended.close();
        let found = found.context("the old tip stays in force")?;
        let [x, y, z] = found.offset.offset_um;
        let warning = rig.add_tip_offset(n, found.offset.clone())?;
        // As people read it: no minus before a zero.
        let [tx, ty, tz] = [x, y, z].map(|um| (10.0 * um).round() / 10.0 + 0.0);
        let mut text = format!(
            "The new tip of {n} is {:.1} µm from the last one, {tx:.1}, {ty:.1}, {tz:.1} µm from the registered one.\n",
            found.moved_um
        );
        if let Some(warning) = &warning {
            text += &format!("{warning}\n");
        }
        if self.dry_run {
            text += &format!("{} stays as it was (--dry-run).\n", path.display());
        } else {
            rig.save(&path)?;
            text += &format!("In force in {}.\n", path.display());
        }
        let warning = warning.map(|w| w.to_string());
        let value = json!({
            "manipulator": n, "offset_um": [x, y, z], "moved_um": found.moved_um, "confidence": found.confidence, "warning": warning,
        });
        out.result(&text, &value)
    }
}
