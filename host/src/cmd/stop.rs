//! `parfocal stop`: works for anyone, whoever has control.

use super::connection::{Connection, Purpose};
use super::{Output, simulated};
use anyhow::bail;
use parfocal_protocol::message::{Request, Stop};

/// Stop all axes, decelerated; works while another program has control
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Outputs off at once instead; positions stay counted but are flagged
    #[arg(long, conflicts_with = "clear")]
    emergency: bool,
    /// Leave the emergency stop, once its switch is released
    #[arg(long)]
    clear: bool,
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When a board cannot be reached, or the emergency stop is still pressed.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let purpose = if self.clear { Purpose::Control } else { Purpose::Look };
        let mut bench = connection.open(purpose, model)?;
        let boards = bench.stage.boards_mut().len();
        if self.clear {
            for link in bench.stage.boards_mut() {
                link.request(Request::ClearEmergency)?;
            }
            bench.stage.close();
            return out.result("the emergency stop is cleared", &serde_json::json!({ "cleared": boards }));
        }
        let how = if self.emergency { Stop::Emergency } else { Stop::Decelerate };
        let stopped = bench.stage.stop(how);
        bench.stage.close();
        if stopped < boards {
            bail!(
                "{} of {boards} boards did not answer; they stop by themselves because they hear nothing",
                boards - stopped
            );
        }
        out.result("stopped", &serde_json::json!({ "stopped": stopped }))
    }
}
