//! `parfocal coaxial`: a pipette along its own axis.

use super::Output;
use super::connection::Connection;
use super::guarded::MoveArguments;
use parfocal::procedure::coaxial;
use parfocal::rig::ManipulatorNumber;
use parfocal_protocol::units::Micrometres;

/// Advance a pipette along its own axis, or withdraw it
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Whose pipette
    #[arg(long, value_name = "N")]
    manipulator: ManipulatorNumber,
    /// How far, µm: above 0 advances, below 0 withdraws
    #[arg(value_name = "UM", allow_hyphen_values = true, value_parser = distance)]
    by: f64,
    #[command(flatten)]
    moving: MoveArguments,
}

fn distance(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| format!("'{text}' is no distance in µm"))
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// What is not calibrated, or in the way.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let what = format!("The pipette of {} along its axis by {} µm:", self.manipulator, self.by);
        let aim = |rig: &_, pose: &_| coaxial(rig, pose, self.manipulator, Micrometres(self.by));
        self.moving.run(connection, out, &what, &aim, &|_, _| None)
    }
}
