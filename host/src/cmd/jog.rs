//! `parfocal jog`: keep axes moving at a speed.

use super::connection::{Connection, Purpose};
use super::{Output, interrupt, simulated};
use anyhow::Context;
use parfocal::rig::AxisName;
use parfocal_protocol::message::Stop;
use parfocal_protocol::units::MicrometresPerSecond;
use std::str::FromStr;

/// Keep axes moving at a speed, until Ctrl-C, for a time, or to their soft limits: `parfocal jog scope.z=-20 --for-s 2`
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// AXIS=UM_PER_S, negative towards smaller positions
    #[arg(required = true, value_name = "AXIS=UM_PER_S")]
    speeds: Vec<Speed>,
    /// Decelerate after so many seconds [default: at Ctrl-C]
    #[arg(long, value_name = "S")]
    for_s: Option<f64>,
}

/// How fast one axis shall go.
#[derive(Clone, Copy, Debug)]
struct Speed {
    axis: AxisName,
    um_s: f32,
}

impl FromStr for Speed {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let wrong = || String::from("write AXIS=UM_PER_S, as in scope.z=-20");
        let (axis, um_s) = s.split_once('=').ok_or_else(wrong)?;
        let um_s = um_s.trim().parse().ok().filter(|v: &f32| v.is_finite() && *v != 0.0).ok_or_else(wrong)?;
        let axis = axis.trim().parse().map_err(|e: parfocal::rig::NameError| e.to_string())?;
        Ok(Self { axis, um_s })
    }
}

/// Longest time that a jog is let run, s: a day.
const LONGEST_S: f64 = 86_400.0;

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When a speed is refused, or a motion ends early.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let for_s = self.for_s.unwrap_or(LONGEST_S);
        anyhow::ensure!(
            for_s > 0.0 && for_s <= LONGEST_S,
            "--for-s {for_s}: must lie between 0 and {LONGEST_S} seconds"
        );
        interrupt::watch();
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let mut bench = connection.open(Purpose::Control, model)?;
        let done = self.jog(&mut bench.stage, for_s);
        let mut rows = Vec::new();
        if done.is_err() {
            // Other boards know nothing of what went wrong on one.
            bench.stage.stop(Stop::Decelerate);
        } else {
            for speed in &self.speeds {
                rows.push((speed.axis.to_string(), bench.stage.position(speed.axis)?.0));
            }
        }
        bench.stage.close();
        done?;
        let text = rows.iter().map(|(axis, um)| format!("{axis} at {um:.3} µm")).collect::<Vec<_>>().join("\n");
        let positions: serde_json::Map<_, _> = rows.into_iter().map(|(axis, um)| (axis, um.into())).collect();
        out.result(&text, &serde_json::json!({ "positions_um": positions }))
    }

    fn jog(&self, stage: &mut parfocal::stage::Stage, for_s: f64) -> anyhow::Result<()> {
        let mut begun = Vec::new();
        for Speed { axis, um_s } in &self.speeds {
            begun.push(stage.jog(*axis, MicrometresPerSecond(*um_s)).with_context(|| axis.to_string())?);
        }
        stage.let_run(&begun, (for_s * 1e3) as u64, &interrupt::keep_on)?;
        for Speed { axis, .. } in &self.speeds {
            stage.jog(*axis, MicrometresPerSecond(0.0))?;
        }
        // An interrupt has done what it was for: the end of a jog is no error.
        Ok(stage.wait(&begun, &|| true)?)
    }
}
