//! Moves by the calibration: looked at first, then made; with `--dry-run` only looked at and drawn.

use super::connection::{Bench, Connection, Purpose};
use super::{Output, interrupt, simulated};
use anyhow::Context;
use clap::Args;
use parfocal::calibration::chain::Arm;
use parfocal::procedure::drawing::{self, Path as Line};
use parfocal::procedure::{Guard, Pose, ProcedureError, Targets};
use parfocal::rig::{Device, Rig};
use parfocal_protocol::units::Micrometres;
use serde_json::json;
use std::path::PathBuf;

/// Options of moves by the calibration.
#[derive(Debug, Args)]
pub struct MoveArguments {
    /// Only say and draw where it would go; nothing moves
    #[arg(long)]
    dry_run: bool,
    /// Draw the way, from above and from the side, as SVG
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
}

/// Loads the rig's file, which these commands cannot do without.
///
/// # Errors
/// What is wrong with it.
pub fn rig_file(connection: &Connection) -> anyhow::Result<Rig> {
    let path = connection.rig.as_deref().context("give --rig FILE: it holds the calibration")?;
    Rig::load(path).with_context(|| path.display().to_string())
}

impl MoveArguments {
    /// Asks `aim` where to go from where everything is, looks at the way, and goes. `expected` says how far off the end may be:
    /// one standard deviation in each direction.
    ///
    /// # Errors
    /// What is not calibrated, or in the way. Nothing has moved then.
    pub fn run(
        &self,
        connection: &Connection,
        out: Output,
        what: &str,
        aim: &dyn Fn(&Rig, &Pose) -> Result<Targets, ProcedureError>,
        expected: &dyn Fn(&Rig, &Pose) -> Option<Micrometres>,
    ) -> anyhow::Result<()> {
        interrupt::watch();
        let rig = rig_file(connection)?;
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let Bench { mut stage, .. } = connection.open(Purpose::Control, model)?;
        let mut guard = Guard::new(&mut stage, &rig, &interrupt::keep_on);
        let moved = self.go(&mut guard, aim);
        stage.close();
        let (from, targets) = moved?;
        if let Some(path) = &self.plot {
            let svg =
                drawing::moves(what.trim_end_matches(':'), &lines(&rig, &from, &targets), &rig.contents().obstacles);
            std::fs::write(path, svg).with_context(|| format!("{}: cannot be written", path.display()))?;
        }
        let axis = |(name, at): &(parfocal::rig::AxisName, _)| {
            let at: Micrometres = *at;
            format!("{name:<8} {:>10.2} -> {:>10.2} µm", from.axis(*name).0, at.0)
        };
        let rows: Vec<String> = targets.iter().map(axis).collect();
        let end = if self.dry_run { "Nothing moved (--dry-run); the way is free." } else { "There." };
        let to: serde_json::Map<_, _> = targets.iter().map(|(name, at)| (name.to_string(), json!(at.0))).collect();
        let error = expected(&rig, &from.with(&targets));
        let told = error.map_or(String::new(), |error| {
            format!("\nExpected error: {:.2} µm in each direction (one standard deviation).", error.0)
        });
        let text = format!("{what}\n{}\n{end}{told}", rows.join("\n"));
        let error_um = error.map(|error| error.0);
        out.result(&text, &json!({ "positions_um": to, "moved": !self.dry_run, "expected_error_um": error_um }))
    }

    fn go(
        &self,
        guard: &mut Guard<'_>,
        aim: &dyn Fn(&Rig, &Pose) -> Result<Targets, ProcedureError>,
    ) -> Result<(Pose, Targets), ProcedureError> {
        let from = guard.pose()?;
        let targets = aim(guard.rig(), &from)?;
        let mut devices: Vec<Device> = targets.iter().map(|(name, _)| name.device).collect();
        // A place in the picture counts from the microscope's position.
        devices.push(Device::Scope);
        guard.trusted(&devices)?;
        guard.check(&targets)?;
        if !self.dry_run {
            guard.move_to(&targets)?;
        }
        Ok((from, targets))
    }
}

/// Every registered tip's way, and the microscope's.
fn lines(rig: &Rig, from: &Pose, targets: &Targets) -> Vec<Line> {
    let to = from.with(targets);
    let mut lines: Vec<Line> = Vec::new();
    for number in rig.contents().manipulators.keys() {
        if let Ok(arm) = Arm::of(rig, *number) {
            let (a, b) = (arm.tip(from.joints(*number)), arm.tip(to.joints(*number)));
            lines.push(Line { name: format!("tip of {number}"), points: vec![a, b] });
        }
    }
    let (a, b) = (from.microscope(rig), to.microscope(rig));
    lines.push(Line { name: "microscope".into(), points: vec![a.into(), b.into()] });
    lines
}
