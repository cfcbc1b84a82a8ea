//! `parfocal vibrate`: swing an axis, to make what moves with it visible.

use super::connection::{Connection, Purpose};
use super::{Output, interrupt, simulated};
use anyhow::Context;
use parfocal::rig::AxisName;
use parfocal_protocol::units::{Hertz, Micrometres};

/// Swing an axis around where it rests; it ends where it began
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// As in m1.x
    axis: AxisName,
    /// Half the way between the turning points, µm
    #[arg(long, value_name = "UM", default_value_t = 2.0)]
    amplitude_um: f64,
    /// Swings in a second, Hz
    #[arg(long, value_name = "HZ", default_value_t = 5.0)]
    frequency_hz: f32,
    /// Whole swings
    #[arg(long, value_name = "N", default_value_t = 10)]
    cycles: u16,
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When the board refuses: it names what is out of range.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        interrupt::watch();
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let mut bench = connection.open(Purpose::Control, model)?;
        let (amplitude, frequency) = (Micrometres(self.amplitude_um), Hertz(self.frequency_hz));
        let swung = bench
            .stage
            .vibrate(self.axis, amplitude, frequency, self.cycles)
            .and_then(|begun| bench.stage.wait(&[begun], &interrupt::keep_on))
            .and_then(|()| bench.stage.position(self.axis));
        bench.stage.close();
        let at = swung.with_context(|| self.axis.to_string())?.0;
        let text = format!(
            "{} swung {} times by ±{} µm at {} Hz, and is back at {at:.3} µm",
            self.axis, self.cycles, self.amplitude_um, self.frequency_hz
        );
        out.result(&text, &serde_json::json!({ "axis": self.axis.to_string(), "position_um": at }))
    }
}
