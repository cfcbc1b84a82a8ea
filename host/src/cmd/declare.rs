//! `parfocal declare`: say where axes are.

use super::connection::{Connection, Purpose};
use super::{Output, simulated};
use anyhow::Context;
use parfocal::rig::AxisName;
use parfocal_protocol::units::Micrometres;
use std::str::FromStr;

/// Say where resting axes are, without moving them: `parfocal declare scope.z=0`
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// AXIS=UM; a calibration that was made from another zero no longer holds
    #[arg(required = true, value_name = "AXIS=UM")]
    positions: Vec<Position>,
}

/// Where one axis is.
#[derive(Clone, Copy, Debug)]
struct Position {
    axis: AxisName,
    um: f64,
}

impl FromStr for Position {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let wrong = || String::from("write AXIS=UM, as in scope.z=0");
        let (axis, um) = s.split_once('=').ok_or_else(wrong)?;
        let um = um.trim().parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(wrong)?;
        let axis = axis.trim().parse().map_err(|e: parfocal::rig::NameError| e.to_string())?;
        Ok(Self { axis, um })
    }
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When something moves, or a board does not answer.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let mut bench = connection.open(Purpose::Control, model)?;
        let mut rows = Vec::new();
        let done = self.positions.iter().try_for_each(|Position { axis, um }| {
            bench.stage.declare(*axis, Micrometres(*um)).with_context(|| axis.to_string())?;
            rows.push((axis.to_string(), bench.stage.position(*axis)?.0));
            anyhow::Ok(())
        });
        bench.stage.close();
        done?;
        let text = rows.iter().map(|(axis, um)| format!("{axis} is at {um:.3} µm")).collect::<Vec<_>>().join("\n");
        let positions: serde_json::Map<_, _> = rows.into_iter().map(|(axis, um)| (axis, um.into())).collect();
        out.result(&text, &serde_json::json!({ "positions_um": positions }))
    }
}
