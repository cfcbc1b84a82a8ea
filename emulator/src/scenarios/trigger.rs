//! Camera pulses: each on the tick of its step, or not at all.

use super::{axis_settings, connect, rest};
use crate::Machine;
use crate::figures::Figures;
use crate::talk::{Link, Talk};
use crate::trace::TICK_HZ;
use anyhow::{Context, ensure};
use parfocal_protocol::message::{Event, Refusal, Request, TriggerPlan};
use parfocal_protocol::settings::{AxisSettings, Driver, Edges};
use parfocal_protocol::units::{
    Axis, MicrometresPerSecond, MicrometresPerSecond2, MicrometresPerSecond3, Nanometres, StepsPerMicrometre,
};
use std::path::Path;
use std::time::Duration;

/// A pulse is high for at least so long, and low as long before the next: half a service of the step interrupt, ticks.
const WIDTH: u64 = 4_200;

/// What one move came to.
struct Run {
    /// Pulses that came out, by the told events.
    given: usize,
    /// Greatest distance from the step, ticks.
    jitter: u64,
    /// The fastest interval at which the axis stepped, ticks.
    fastest: u64,
}

/// Pulses on every axis that has them: slow and fast, up and down, inverted, with play, both edges, and in a stall.
///
/// # Errors
/// When a pulse is beside its step, missing where it should come, or told wrongly.
pub fn pulses(elf: &Path, figures: &mut Figures) -> anyhow::Result<String> {
    let (mut board, mut talk) = connect(elf, Link::Usb)?;
    let plain = AxisSettings { steps_per_um: StepsPerMicrometre(20.0), ..AxisSettings::default() };
    let settings = [
        plain,
        AxisSettings { inverted: true, backlash: Nanometres(2_000), ..plain },
        AxisSettings {
            steps_per_um: StepsPerMicrometre(400.0),
            acceleration: MicrometresPerSecond2(20_000.0),
            jerk: MicrometresPerSecond3(4_000_000.0),
            driver: Driver::Tmc2209,
            ..plain
        },
    ];
    for (axis, settings) in settings.into_iter().enumerate() {
        axis_settings(&mut board, &mut talk, axis, settings)?;
    }
    let (mut jitter, mut given, mut fastest) = (0, 0, u64::MAX);
    let every = |axis, first: i32, every: i32, count| TriggerPlan::Every {
        axis: Axis(axis),
        first: Nanometres(first * 1000),
        every: Nanometres(every * 1000),
        count,
    };
    let listed = |axis, at: [i32; 8], len| TriggerPlan::At {
        axis: Axis(axis),
        positions: at.map(|um| Nanometres(um * 1000)),
        len,
    };
    for (axis, to, plan, wanted) in [
        (0, 100, every(0, 10, 2, 40), 40),
        (0, 0, every(0, 90, -5, 15), 15),
        (1, 60, every(1, 5, 3, 18), 18),
        (1, -10, listed(1, [50, 44, 20, -3, 0, 0, 0, 0], 4), 4),
        // 400,000 steps a second at the top.
        (2, 130, every(2, 10, 5, 24), 24),
    ] {
        let run = run(&mut board, &mut talk, axis, to, plan, &settings[axis])?;
        ensure!(run.given == wanted, "axis {axis} to {to} µm: {} pulses came instead of {wanted}", run.given);
        jitter = jitter.max(run.jitter);
        fastest = fastest.min(run.fastest);
        given += run.given;
    }
    ensure!(jitter == 0, "pulses come up to {jitter} ticks beside their steps");
    // Pulses asked for closer than the output can give them: fewer come, each on its step.
    let crowded = run(&mut board, &mut talk, 0, 50, every(0, 10, 1, 20).closer(), &settings[0])?;
    ensure!(crowded.jitter == 0 && crowded.given > 2, "{} pulses, {} ticks off", crowded.given, crowded.jitter);
    let axis = Axis(3);
    let refusal = talk.try_ask(&mut board, Request::Trigger { plan: every(3, 1, 1, 1) })?;
    ensure!(refusal == Err(Refusal::NoTrigger { axis }), "the fourth axis' trigger was answered by {refusal:?}");
    // Both edges are steps: the pulse comes with the pair's first.
    let both = AxisSettings { edges: Edges::Both, ..settings[2] };
    axis_settings(&mut board, &mut talk, 2, both)?;
    let pairs = run(&mut board, &mut talk, 2, 60, every(2, 120, -5, 11), &both)?;
    ensure!(pairs.given == 11, "{} pulses came with both edges", pairs.given);
    board.stop()?.clean()?;
    figures.trigger_jitter_ticks = Some(jitter);
    Ok(format!(
        "{given} pulses, up to {:.0} steps/s: jitter {jitter} ticks; of 20 asked for {} µs apart {} came, on their steps",
        TICK_HZ as f64 / fastest as f64,
        50,
        crowded.given
    ))
}

/// The same plan with a twentieth of the distance.
trait Closer {
    fn closer(self) -> Self;
}

impl Closer for TriggerPlan {
    fn closer(self) -> Self {
        match self {
            Self::Every { axis, first, every, count } => {
                Self::Every { axis, first, every: Nanometres(every.0 / 20), count }
            }
            other => other,
        }
    }
}

/// One move with a plan: holds every pulse against its step.
fn run(
    board: &mut Machine,
    talk: &mut Talk,
    axis: usize,
    to_um: i32,
    plan: TriggerPlan,
    settings: &AxisSettings,
) -> anyhow::Result<Run> {
    let began = talk.status(board)?.axes[axis].steps.0;
    talk.ask(board, Request::Trigger { plan })?;
    for trace in board.world.axes.iter().chain([&board.world.camera]) {
        trace.lock().expect("turns").clear_edges();
    }
    talk.events.clear();
    let mut to = [None; 4];
    to[axis] = Some(Nanometres(to_um * 1000));
    talk.ask(board, Request::Move { to, speed: Some(MicrometresPerSecond(settings.speed.0)) })?;
    rest(board, talk, Duration::from_millis(20))?;
    let told: Vec<(u16, u64, i32)> = talk
        .events
        .drain(..)
        .filter_map(|event| match event {
            Event::Triggered { index, time, position } => Some((index, time.0, position.0)),
            _ => None,
        })
        .collect();
    let camera = board.world.camera.lock().expect("turns");
    let trace = board.world.axes[axis].lock().expect("turns");
    let both = settings.edges == Edges::Both;
    let steps: Vec<u64> = if both { trace.step.iter().map(|e| e.tick).collect() } else { trace.rises().collect() };
    let rises: Vec<u64> = camera.rises().collect();
    ensure!(rises.len() == told.len(), "{} pulses came out and {} are told", rises.len(), told.len());
    ensure!(
        camera.step.windows(2).all(|w| w[1].tick - w[0].tick >= WIDTH),
        "a pulse, or what lies between two, is shorter than {WIDTH} ticks"
    );
    let up = to_um * 1000 > settings.steps_per_um.nanometres(parfocal_protocol::units::Steps(began)).0;
    let play = settings.steps_per_um.steps(settings.backlash).0;
    let mut jitter = 0;
    for (rise, (index, time, position)) in rises.iter().zip(&told) {
        let asked = match plan {
            TriggerPlan::Every { first, every, .. } => first.0 + every.0 * i32::from(*index),
            TriggerPlan::At { positions, .. } => positions[usize::from(*index)].0,
            TriggerPlan::Off => anyhow::bail!("a pulse without a plan"),
        };
        ensure!(*position == asked, "pulse {index} is told at {position} nm instead of {asked}");
        let motor = settings.steps_per_um.steps(Nanometres(asked)).0 + if up { play } else { 0 };
        let step = (motor - began).unsigned_abs() as usize;
        let due = *steps.get(step.wrapping_sub(1)).context("a pulse beyond the last step")?;
        if both {
            // The record's first edge: that of the step, or the one before it.
            let before = step.checked_sub(2).and_then(|i| steps.get(i)).copied().unwrap_or(due);
            ensure!(
                *rise == due || *rise == before,
                "pulse {index} at {rise}, its step at {due}, the one before at {before}"
            );
        } else {
            jitter = jitter.max(rise.abs_diff(due));
        }
        // The board's clock is in µs; its zero is that of its time driver, not of the timers.
        ensure!(*time > 0, "a pulse is told without a time");
    }
    for (a, b) in rises.windows(2).zip(told.windows(2)).map(|(r, t)| ((r[1] - r[0]) / 84, t[1].1 - t[0].1)) {
        ensure!(a.abs_diff(b) <= 1, "two pulses are {a} µs apart, and {b} by the board's word");
    }
    Ok(Run { given: told.len(), jitter, fastest: steps.windows(2).map(|w| w[1] - w[0]).min().unwrap_or(u64::MAX) })
}
