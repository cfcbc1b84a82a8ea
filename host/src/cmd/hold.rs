//! `parfocal hold` and `parfocal resume`: feed hold of moves that go on by themselves (`parfocal move --no-wait`).

use super::connection::{Connection, Purpose};
use super::{Output, simulated};

/// Decelerate and keep the moves that wait; `parfocal resume` goes on
#[derive(Debug, clap::Args)]
pub struct Hold {}

/// Go on after `parfocal hold`
#[derive(Debug, clap::Args)]
pub struct Resume {}

impl Hold {
    /// Runs the command.
    ///
    /// # Errors
    /// When a board does not answer, or another program controls it.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        hold(connection, true)?;
        out.result("held: `parfocal resume` goes on, `parfocal stop` ends it", &serde_json::json!({ "held": true }))
    }
}

impl Resume {
    /// Runs the command.
    ///
    /// # Errors
    /// When a board does not answer, or another program controls it.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        hold(connection, false)?;
        out.result("goes on", &serde_json::json!({ "held": false }))
    }
}

fn hold(connection: &Connection, on: bool) -> anyhow::Result<()> {
    let model = simulated::Model { seed: connection.seed, ..Default::default() };
    let mut bench = connection.open(Purpose::Control, model)?;
    let done = bench.stage.hold(on);
    bench.stage.close();
    Ok(done?)
}
