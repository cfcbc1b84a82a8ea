//! `parfocal info`: who the boards are.

use super::connection::{Connection, Purpose, hex};
use super::{Output, simulated};
use parfocal::link::explain::{Explained, reset_cause};
use parfocal_protocol::message::{Hello, Role};
use serde::Serialize;

/// Say who the boards are: firmware, unique id, why they last started
#[derive(Debug, clap::Args)]
pub struct Arguments {}

#[derive(Serialize)]
struct Row {
    port: String,
    board: String,
    unique_id: String,
    firmware: String,
    git: String,
    protocol: u8,
    axes: u8,
    started_by: &'static str,
    can_save_settings: bool,
    last_stop: Option<String>,
    may_control: bool,
}

impl Row {
    fn new(port: String, hello: &Hello) -> Self {
        let [major, minor, patch] = hello.firmware;
        Self {
            port,
            board: hello.board.as_str().into(),
            unique_id: hex(&hello.unique_id),
            firmware: format!("{major}.{minor}.{patch}"),
            git: hello.git.as_str().into(),
            protocol: parfocal_protocol::VERSION,
            axes: hello.axes,
            started_by: reset_cause(hello.reset),
            can_save_settings: hello.can_save,
            last_stop: hello.last_stop.map(|cause| Explained(&cause).to_string()),
            may_control: hello.role == Role::Control,
        }
    }

    fn text(&self) -> String {
        let saves = if self.can_save_settings { "" } else { "\n  cannot keep settings on this chip revision" };
        let stop = self.last_stop.as_ref().map_or(String::new(), |s| format!("\n  last stop: {s}"));
        format!(
            "{} on {}: unique id {}, firmware {} ({}), protocol {}, {} axes; last start: {}{saves}{stop}",
            self.board, self.port, self.unique_id, self.firmware, self.git, self.protocol, self.axes, self.started_by
        )
    }
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When no board answers.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let mut bench = connection.open(Purpose::Look, model)?;
        let rows: Vec<Row> = bench.stage.boards_mut().iter().map(|link| Row::new(link.port(), link.hello())).collect();
        bench.stage.close();
        let text = rows.iter().map(Row::text).collect::<Vec<_>>().join("\n");
        out.result(&text, &serde_json::json!({ "boards": rows }))
    }
}
