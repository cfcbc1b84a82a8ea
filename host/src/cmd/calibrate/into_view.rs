//! `parfocal calibrate into-view`.

use super::objective::change;
use super::{Output, Solving, now};
use crate::cmd::connection::Connection;
use crate::cmd::live::{LiveArguments, Room};
use anyhow::{Context, bail};
use clap::Args;
use parfocal::procedure::{InView, IntoViewPlan, Purpose, into_view};
use parfocal::rig::{ManipulatorNumber, Rig};

/// Options of `parfocal calibrate into-view`.
#[derive(Debug, Args)]
pub struct IntoView {
    #[command(flatten)]
    solving: Solving,
    #[command(flatten)]
    live: LiveArguments,
    /// Whose tip
    #[arg(long, value_name = "N")]
    manipulator: ManipulatorNumber,
    /// Objectives to look through, the weakest first; the tip is in the last one's picture in the end
    #[arg(long, value_name = "NAME,…", value_delimiter = ',', required = true)]
    through: Vec<String>,
}

impl IntoView {
    /// # Errors
    /// What stopped it: no coarse registration, an obstacle, no tip within three standard deviations.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        if self.solving.samples.is_some() {
            bail!("a tip is brought into view live: leave --samples away");
        }
        let number = self.manipulator;
        let room = Room::new(&self.live, self.solving.rig.as_deref(), connection, self.solving.seed)?;
        known(&room.known()?, &self.through)?;
        let plan = IntoViewPlan { manipulator: number, objectives: self.through.clone() };
        let mut found: Option<InView> = None;
        let path = room.rig;
        let name = format!("into-view {number}");
        room.run(&name, Purpose::Registration, &mut |live, finder, recorder, around| {
            let mut turret = |name: &str| change(path, name, around);
            found = Some(into_view(live, finder, &plan, &mut turret, recorder)?);
            Ok(())
        })?;
        let found = found.context("the search ended without a word")?;
        let mut rig = Rig::load(path)?;
        found.put(&mut rig, number, now())?;
        let by = found.correction.coordinates;
        let at = found.seen.pixel;
        let text = format!(
            "The tip of {number} is in view through {} at {:.1}, {:.1} px. The markers were {:.0} µm off; now its coarse registration is \
             good to {:.1} µm here.\n{}",
            self.through.last().map_or("", String::as_str),
            at.x_px,
            at.y_px,
            by.norm(),
            found.error_um,
            self.solving.save(&mut rig)?
        );
        let json = serde_json::json!({
            "manipulator": number,
            "pixel": [at.x_px, at.y_px],
            "correction_um": [by.x, by.y, by.z],
            "error_um": found.error_um,
            "confidence": found.seen.found.confidence,
        });
        out.result(&text, &json)
    }
}

/// Refuses objectives that the rig's file does not have.
pub fn known(rig: &Rig, through: &[String]) -> anyhow::Result<()> {
    let objectives = &rig.contents().objectives;
    if let Some(unknown) = through.iter().find(|name| !objectives.contains_key(*name)) {
        let names: Vec<_> = objectives.keys().map(String::as_str).collect();
        bail!("objective '{unknown}' is not in the rig's file; it has: {}", names.join(", "));
    }
    Ok(())
}
