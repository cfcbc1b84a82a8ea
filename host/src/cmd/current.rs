//! `parfocal enable` and `parfocal disable`: the current of the motors' drivers.

use super::connection::{Connection, Purpose};
use super::{Output, simulated};
use anyhow::Context;
use parfocal::rig::AxisName;

/// Switch motor current on
#[derive(Debug, clap::Args)]
pub struct Enable {
    /// As in scope.z
    #[arg(required = true)]
    axes: Vec<AxisName>,
}

/// Switch motor current off; a needle may then drift
#[derive(Debug, clap::Args)]
pub struct Disable {
    /// As in scope.z
    #[arg(required = true)]
    axes: Vec<AxisName>,
}

impl Enable {
    /// Runs the command.
    ///
    /// # Errors
    /// When a board does not answer.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        switch(connection, &self.axes, true, out)
    }
}

impl Disable {
    /// Runs the command.
    ///
    /// # Errors
    /// When something moves, or a board does not answer.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        switch(connection, &self.axes, false, out)
    }
}

fn switch(connection: &Connection, axes: &[AxisName], on: bool, out: Output) -> anyhow::Result<()> {
    let model = simulated::Model { seed: connection.seed, ..Default::default() };
    let mut bench = connection.open(Purpose::Control, model)?;
    let done = axes.iter().try_for_each(|axis| bench.stage.enable(*axis, on).with_context(|| axis.to_string()));
    bench.stage.close();
    done?;
    let names: Vec<String> = axes.iter().map(ToString::to_string).collect();
    let text = format!("{}: current {}", names.join(", "), if on { "on" } else { "off" });
    out.result(&text, &serde_json::json!({ "axes": names, "enabled": on }))
}
