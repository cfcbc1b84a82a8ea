//! Camera pulses of `parfocal move`: which ones are asked for, and which ones were given.

use anyhow::{Context, bail};
use parfocal::rig::AxisName;
use parfocal::stage::Stage;
use parfocal_protocol::message::{Event, TriggerPlan};
use parfocal_protocol::units::{BoardTime, Micrometres, Nanometres};
use serde::Serialize;

/// Camera pulses on the way. Its name must differ from those of other groups of arguments.
#[derive(Clone, Debug, clap::Args)]
pub struct Pulses {
    /// Give a camera pulse every so many µm of the way, on the very step
    #[arg(long, value_name = "UM", conflicts_with = "pulse_at_um")]
    pulse_every_um: Option<f64>,
    /// Where the first of them is given [default: after the first such distance]
    #[arg(long, value_name = "UM", requires = "pulse_every_um", allow_hyphen_values = true)]
    pulse_from_um: Option<f64>,
    /// Give camera pulses at these positions, at most 8
    #[arg(long, value_name = "UM,UM", value_delimiter = ',', allow_hyphen_values = true)]
    pulse_at_um: Vec<f64>,
    /// The axis whose way counts [default: the one that moves]
    #[arg(long, value_name = "AXIS")]
    pulse_axis: Option<AxisName>,
}

/// A pulse that the board gave.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Pulse {
    /// Its number within the plan, from 0: the frame's index.
    pub index: u16,
    /// Where the axis was, µm.
    pub position_um: f64,
    /// When, by the board's clock, µs.
    pub board_us: u64,
}

/// Pulses asked for.
pub struct Planned {
    axis: AxisName,
    plan: TriggerPlan,
    count: u16,
}

/// Most pulses of a plan, as the board has it.
const MOST: f64 = 60_000.0;

impl Pulses {
    /// The plan for a move to `targets`, all absolute; `None` when no pulses are asked for.
    ///
    /// # Errors
    /// Says which option is wrong, and its range.
    pub fn plan(&self, stage: &mut Stage, targets: &[(AxisName, Micrometres)]) -> anyhow::Result<Option<Planned>> {
        if self.pulse_every_um.is_none() && self.pulse_at_um.is_empty() {
            return Ok(None);
        }
        let (axis, to) = match (self.pulse_axis, targets) {
            (Some(axis), _) => {
                let found = targets.iter().find(|(name, _)| *name == axis);
                *found.with_context(|| format!("--pulse-axis {axis}: does not move"))?
            }
            (None, [one]) => *one,
            _ => bail!("several axes move: say with --pulse-axis whose way counts"),
        };
        let nm = |um: f64| Micrometres(um).nanometres().with_context(|| format!("{um} µm is no position of a stage"));
        let from = stage.position(axis)?.0;
        let forward = to.0 >= from;
        let number = stage.find(axis)?.1;
        if let Some(every) = self.pulse_every_um {
            if !(0.001..=1e6).contains(&every) {
                bail!("--pulse-every-um {every}: must lie between 0.001 and 1000000");
            }
            let every = if forward { every } else { -every };
            let first = self.pulse_from_um.unwrap_or(from + every);
            // Positions are whole nm: the last one may be the end of the move itself.
            let count = ((to.0 - first) / every + 1e-6).floor() + 1.0;
            let start = if self.pulse_from_um.is_some() { (first - from) * every.signum() } else { 0.0 };
            if !(start >= 0.0 && count >= 1.0) {
                bail!("no pulse lies between {from} and {} µm: the first would be at {first}", to.0);
            }
            if count > MOST {
                bail!("--pulse-every-um {}: makes {count} pulses, and {MOST} are the most", every.abs());
            }
            let (first, every, count) = (nm(first)?, nm(every)?, count as u16);
            return Ok(Some(Planned { axis, plan: TriggerPlan::Every { axis: number, first, every, count }, count }));
        }
        let mut at = self.pulse_at_um.clone();
        at.sort_by(f64::total_cmp);
        if !forward {
            at.reverse();
        }
        let (low, high) = (from.min(to.0), from.max(to.0));
        if let Some(beside) = at.iter().find(|um| !(**um >= low && **um <= high)) {
            bail!("--pulse-at-um {beside}: the way goes from {from} to {} µm", to.0);
        }
        let mut positions = [Nanometres(0); 8];
        if at.len() > positions.len() {
            bail!("--pulse-at-um: at most {} positions, not {}", positions.len(), at.len());
        }
        for (place, um) in positions.iter_mut().zip(&at) {
            *place = nm(*um)?;
        }
        let len = at.len() as u8;
        let plan = TriggerPlan::At { axis: number, positions, len };
        Ok(Some(Planned { axis, plan, count: len.into() }))
    }
}

impl Planned {
    /// Tells the board.
    ///
    /// # Errors
    /// When the board refuses.
    pub fn begin(&self, stage: &mut Stage) -> anyhow::Result<()> {
        stage.trigger(self.axis, |_| self.plan).with_context(|| self.axis.to_string())
    }

    /// No pulses from now on.
    ///
    /// # Errors
    /// When the board does not answer.
    pub fn end(&self, stage: &mut Stage) -> anyhow::Result<()> {
        Ok(stage.trigger(self.axis, |_| TriggerPlan::Off)?)
    }

    /// What the pulses came to, for people.
    pub fn text(&self, given: &[Pulse]) -> String {
        let mut text = format!("{} of {} camera pulses were given", given.len(), self.count);
        if given.len() < usize::from(self.count) {
            text += ": the others came too soon after the one before, or before the board could prepare them; move slower, or ask for fewer";
        }
        for Pulse { index, position_um, board_us } in given {
            text += &format!("\n{index:>6} {position_um:>12.3} µm  {board_us} µs");
        }
        text
    }
}

/// The pulse that an event tells of.
pub fn pulse(event: &Event) -> Option<Pulse> {
    match *event {
        Event::Triggered { index, time: BoardTime(board_us), position } => {
            Some(Pulse { index, position_um: position.micrometres().0, board_us })
        }
        _ => None,
    }
}
