//! `parfocal home`: find the home switches.

use super::connection::{Connection, Purpose};
use super::{Output, interrupt, simulated};
use anyhow::Context;
use parfocal::rig::AxisName;

/// Find the home switch of axes, one after the other: their positions are known from then on
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// As in scope.z
    #[arg(required = true)]
    axes: Vec<AxisName>,
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When an axis has no home switch in its settings, or its switch is stuck, missing or on the wrong side.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        interrupt::watch();
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let mut bench = connection.open(Purpose::Control, model)?;
        let mut rows = Vec::new();
        let mut done = Ok(());
        for axis in self.axes {
            let homed = bench.stage.home(axis).and_then(|begun| bench.stage.wait(&[begun], &interrupt::keep_on));
            done = homed.with_context(|| axis.to_string());
            if done.is_err() {
                break;
            }
            rows.push((axis.to_string(), bench.stage.position(axis)?.0));
        }
        bench.stage.close();
        done?;
        let text =
            rows.iter().map(|(axis, um)| format!("{axis} is homed, and at {um:.3} µm")).collect::<Vec<_>>().join("\n");
        let positions: serde_json::Map<_, _> = rows.into_iter().map(|(axis, um)| (axis, um.into())).collect();
        out.result(&text, &serde_json::json!({ "homed_um": positions }))
    }
}
