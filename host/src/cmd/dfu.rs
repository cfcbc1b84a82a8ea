//! `parfocal dfu`: restart a board into its chip's own bootloader.

use super::connection::{Connection, Purpose};
use super::{Output, simulated};
use anyhow::bail;
use parfocal_protocol::message::Request;

/// Restart the board on --port into its chip's USB bootloader (outputs go inactive first), for flashing without a debugger
#[derive(Debug, clap::Args)]
pub struct Arguments {}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When not exactly one board is named, something moves, or the board has no bootloader.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let [port] = &connection.port[..] else {
            bail!("name the one board to restart with --port: `parfocal ports` lists them")
        };
        if connection.is_simulated() {
            bail!("the simulated rig has no bootloader");
        }
        let port = port.clone();
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let mut bench = connection.open(Purpose::Control, model)?;
        // The board answers, then leaves: there is no session to end.
        for link in bench.stage.boards_mut() {
            link.request(Request::EnterDfu)?;
        }
        let text = format!(
            "the board on {port} restarts into its bootloader: it appears as USB device 0483:df11, to be flashed with \
             e.g. dfu-util; its reset button brings the present firmware back"
        );
        out.result(&text, &serde_json::json!({ "bootloader": port }))
    }
}
