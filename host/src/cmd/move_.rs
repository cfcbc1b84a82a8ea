//! `parfocal move`: axes to positions.

use super::connection::{Connection, Purpose};
use super::{Output, interrupt, simulated};
use parfocal::rig::AxisName;
use parfocal_protocol::units::{Micrometres, MicrometresPerSecond};
use std::str::FromStr;

/// Move axes in a straight line: `parfocal move scope.z=12.5 scope.x+=10`
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// AXIS=UM to a position, AXIS+=UM or AXIS-=UM by a distance
    #[arg(required = true, value_name = "AXIS=UM", allow_hyphen_values = true)]
    targets: Vec<Target>,
    /// Speed along the line, µm/s [default: the fastest that the axes allow]
    #[arg(long, value_name = "UM_PER_S")]
    speed_um_s: Option<f32>,
}

/// Where one axis shall go.
#[derive(Clone, Copy, Debug)]
struct Target {
    axis: AxisName,
    relative: bool,
    um: f64,
}

impl FromStr for Target {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let wrong = || String::from("write AXIS=UM, AXIS+=UM or AXIS-=UM, as in scope.z=12.5");
        let (left, um) = s.split_once('=').ok_or_else(wrong)?;
        let um: f64 = um.trim().parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(wrong)?;
        let (axis, sign, relative) = match left.as_bytes().last() {
            Some(b'+') => (&left[..left.len() - 1], 1.0, true),
            Some(b'-') => (&left[..left.len() - 1], -1.0, true),
            _ => (left, 1.0, false),
        };
        let axis = axis.trim().parse().map_err(|e: parfocal::rig::NameError| e.to_string())?;
        Ok(Self { axis, relative, um: sign * um })
    }
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When a move is refused or ends early.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        interrupt::watch();
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let mut bench = connection.open(Purpose::Control, model)?;
        let mut targets = Vec::new();
        for target in &self.targets {
            let from = if target.relative { bench.stage.position(target.axis)?.0 } else { 0.0 };
            targets.push((target.axis, Micrometres(from + target.um)));
        }
        let began = bench.stage.now();
        let moved = bench.stage.move_to(&targets, self.speed_um_s.map(MicrometresPerSecond), &interrupt::keep_on);
        let seconds = (bench.stage.now().0 - began.0) as f64 / 1e6;
        let mut rows = Vec::new();
        for (axis, _) in &targets {
            rows.push((axis.to_string(), bench.stage.position(*axis)?.0));
        }
        bench.stage.close();
        moved?;
        let text = rows.iter().map(|(axis, um)| format!("{axis} at {um:.3} µm")).collect::<Vec<_>>().join("\n");
        let positions: serde_json::Map<_, _> = rows.into_iter().map(|(axis, um)| (axis, um.into())).collect();
        out.result(&text, &serde_json::json!({ "positions_um": positions, "duration_s": seconds }))
    }
}
