//! `parfocal move`: axes to positions.

use super::connection::{Connection, Purpose};
use super::move_pulses::{self, pulse};
use super::{Output, interrupt, simulated};
use anyhow::Context;
use parfocal::procedure::Guard;
use parfocal::rig::{AxisName, Device, Rig};
use parfocal::stage::Stage;
use parfocal_protocol::units::{Micrometres, MicrometresPerSecond};
use std::path::Path;
use std::str::FromStr;

/// Move axes in a straight line: `parfocal move scope.z=12.5 scope.x+=10`
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// AXIS=UM to a position, AXIS+=UM or AXIS-=UM by a distance
    #[arg(required = true, value_name = "AXIS=UM")]
    targets: Vec<Target>,
    /// Speed along the line, µm/s [default: the fastest that the axes allow]
    #[arg(long, value_name = "UM_PER_S")]
    speed_um_s: Option<f32>,
    /// Come back as soon as the move has begun; `parfocal hold`, `resume`, `stop` and `status` then work beside it
    #[arg(long, conflicts_with_all = ["pulse_every_um", "pulse_at_um"])]
    no_wait: bool,
    /// Do not look at obstacles in the way of tips (with --rig: registered manipulators' tips are looked at)
    #[arg(long)]
    unguarded: bool,
    #[command(flatten)]
    pulses: move_pulses::Pulses,
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
        if !self.unguarded
            && let Some(path) = &connection.rig
        {
            looked_at(path, &mut bench.stage, &targets)?;
        }
        let speed = self.speed_um_s.map(MicrometresPerSecond);
        if self.no_wait {
            let begun = bench.stage.begin(&targets, speed);
            bench.stage.close();
            let motions: Vec<u32> = begun?.into_iter().map(|(_, motion)| motion.0).collect();
            return out.result("begun", &serde_json::json!({ "motions": motions }));
        }
        let moved = self.moved(&mut bench.stage, &targets, speed);
        let mut rows = Vec::new();
        for (axis, _) in &targets {
            rows.push((axis.to_string(), bench.stage.position(*axis)?.0));
        }
        bench.stage.close();
        let Moved { seconds, pulses } = moved?;
        let mut text = rows.iter().map(|(axis, um)| format!("{axis} at {um:.3} µm")).collect::<Vec<_>>().join("\n");
        let positions: serde_json::Map<_, _> = rows.into_iter().map(|(axis, um)| (axis, um.into())).collect();
        let mut json = serde_json::json!({ "positions_um": positions, "duration_s": seconds });
        if let Some((planned, given)) = pulses {
            text += &format!("\n{}", planned.text(&given));
            json["pulses"] = serde_json::to_value(given)?;
        }
        out.result(&text, &json)
    }

    fn moved(
        &self,
        stage: &mut Stage,
        targets: &[(AxisName, Micrometres)],
        speed: Option<MicrometresPerSecond>,
    ) -> anyhow::Result<Moved> {
        let planned = self.pulses.plan(stage, targets)?;
        if let Some(planned) = &planned {
            planned.begin(stage)?;
        }
        let began = stage.now();
        let mut given = Vec::new();
        let begun = stage.begin(targets, speed)?;
        let waited = stage.wait_telling(&begun, &interrupt::keep_on, &mut |event| given.extend(pulse(&event)));
        let seconds = (stage.now().0 - began.0) as f64 / 1e6;
        if let Some(planned) = &planned {
            planned.end(stage)?;
        }
        waited?;
        Ok(Moved { seconds, pulses: planned.map(|planned| (planned, given)) })
    }
}

/// Looks at the way of every tip that the rig's file knows. A manipulator that it does not know moves by eye.
fn looked_at(path: &Path, stage: &mut Stage, targets: &[(AxisName, Micrometres)]) -> anyhow::Result<()> {
    let rig = Rig::load(path).with_context(|| path.display().to_string())?;
    if rig.contents().obstacles.is_empty() {
        return Ok(());
    }
    let mut guard = Guard::new(stage, &rig, &interrupt::keep_on);
    let unknown = |device| matches!(device, Device::Manipulator(n) if !guard.knows(n));
    let (by_eye, known): (Vec<_>, Vec<_>) = targets.iter().copied().partition(|(axis, _)| unknown(axis.device));
    if let Some((axis, _)) = by_eye.first() {
        eprintln!(
            "parfocal: {} is not registered: it moves by eye, nothing looks at obstacles in its way",
            axis.device
        );
    }
    guard.check(&known).context("nothing moved (--unguarded moves all the same, by eye)")
}

/// What came of a move.
struct Moved {
    seconds: f64,
    /// Camera pulses asked for, and given.
    pulses: Option<(move_pulses::Planned, Vec<move_pulses::Pulse>)>,
}
