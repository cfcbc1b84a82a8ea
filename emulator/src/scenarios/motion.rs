//! Moves: every edge on its planned tick, the profile exact, the distance as asked for, the position as told.

use super::{axis_settings, connect, rest};
use crate::exact::{Exact, FINE, fitted};
use crate::figures::Figures;
use crate::planned::Planned;
use crate::talk::Link;
use crate::trace::Trace;
use anyhow::{anyhow, ensure};
use parfocal_firmware::motion::limits::in_ticks;
use parfocal_firmware::motion::playback::Change;
use parfocal_protocol::message::{Event, Request};
use parfocal_protocol::settings::{AxisSettings, BoardSettings};
use parfocal_protocol::units::{Hertz, MicrometresPerSecond, MicrometresPerSecond3, Nanometres, StepsPerMicrometre};
use std::path::Path;
use std::time::Duration;

fn um(x: i32) -> Option<Nanometres> {
    Some(Nanometres(x * 1000))
}

/// Settings unlike each other, so that nothing coincides.
fn settings() -> [AxisSettings; 4] {
    std::array::from_fn(|i| AxisSettings {
        steps_per_um: StepsPerMicrometre([10.0, 12.5, 40.0, 25.0][i]),
        jerk: MicrometresPerSecond3(400_000.0),
        inverted: i == 1,
        ..AxisSettings::default()
    })
}

/// Moves of one axis and of all, against the same moves on a PC and against exact arithmetic.
///
/// # Errors
/// When an edge is missing, surplus or off.
pub fn edges(elf: &Path, figures: &mut Figures) -> anyhow::Result<String> {
    let (mut board, mut talk) = connect(elf, Link::Usb)?;
    let settings = settings();
    for (axis, settings) in settings.iter().enumerate() {
        axis_settings(&mut board, &mut talk, axis, *settings)?;
    }
    let mut planned = Planned::new(&settings).map_err(|r| anyhow!("refused on a PC: {r:?}"))?;
    let (mut jitter, mut profile, mut steps) = (0, 0.0f64, 0);
    let moves = [
        ([um(150), None, None, None], None),
        ([um(-60), None, None, None], Some(MicrometresPerSecond(300.0))),
        ([um(20), um(-35), um(90), um(55)], None),
    ];
    for (to, speed) in moves {
        let plan = planned.move_to(&to, speed).map_err(|r| anyhow!("refused on a PC: {r:?}"))?;
        for axis in &board.world.axes {
            axis.lock().expect("turns").clear_edges();
        }
        talk.ask(&mut board, Request::Move { to, speed })?;
        let status = rest(&mut board, &mut talk, Duration::from_millis(20))?;
        for (axis, target) in to.iter().enumerate() {
            let Some(target) = target else { continue };
            let trace = board.world.axes[axis].lock().expect("turns");
            jitter = jitter.max(compare(axis, &trace, &plan)?);
            let told = status.axes[axis].steps.0;
            let wanted = settings[axis].steps_per_um.steps(*target).0;
            ensure!(told == wanted, "axis {axis} stands at {told} steps instead of {wanted}");
            steps += trace.rises().count();
        }
        if to[1].is_none() {
            let trace = board.world.axes[0].lock().expect("turns");
            profile = profile.max(off_exact(&trace, &settings[0], speed)?);
        }
    }
    board.stop()?.clean()?;
    ensure!(jitter == 0, "edges come up to {jitter} ticks off their plan");
    ensure!(profile <= 1.0, "edges lie up to {profile:.2} ticks off the exact profile");
    figures.edge_jitter_ticks = Some(jitter);
    figures.profile_error_ticks = Some((profile * 1000.0).round() / 1000.0);
    Ok(format!("{steps} steps: jitter {jitter} ticks, {profile:.2} ticks off the exact profile at most"))
}

/// Telemetry at two rates beside moves of three axes: as often as asked for, true, and no step missed for it.
///
/// # Errors
/// When a position is told late, wrongly, or a step is missing.
pub fn telemetry(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    let (mut board, mut talk) = connect(elf, Link::Usb)?;
    let settings = settings();
    for (axis, settings) in settings.iter().enumerate() {
        axis_settings(&mut board, &mut talk, axis, *settings)?;
    }
    let mut said = Vec::new();
    let mut target = 0;
    for hz in [100.0f32, 500.0] {
        let settings = BoardSettings { telemetry: Hertz(hz), ..BoardSettings::default() };
        talk.ask(&mut board, Request::SetBoard { settings })?;
        for axis in &board.world.axes {
            axis.lock().expect("turns").clear_edges();
        }
        let from = target;
        target = 300 - target;
        talk.events.clear();
        talk.ask(&mut board, Request::Move { to: [um(target), um(target), um(target), None], speed: None })?;
        let status = rest(&mut board, &mut talk, Duration::from_millis(20))?;
        let told: Vec<(u64, i32)> = talk
            .events
            .drain(..)
            .filter_map(|event| match event {
                Event::Position { time, steps } => Some((time.0, steps[0].0)),
                _ => None,
            })
            .collect();
        let (first, last) = (told.first().map_or(0, |t| t.0), told.last().map_or(0, |t| t.0));
        let rate = (told.len().max(1) - 1) as f64 / ((last - first).max(1) as f64 / 1e6);
        ensure!(told.len() > 20, "{} positions were told at {hz} Hz", told.len());
        // In step with the rate: only the last look may be late.
        let due = ((last - first) as f64 * f64::from(hz) / 1e6).floor() as usize;
        ensure!(told.len() > due, "{} positions were told in {} µs at {hz} Hz", told.len(), last - first);
        // Two looks apart at most beyond the period.
        let longest = told.windows(2).map(|w| w[1].0 - w[0].0).max().unwrap_or(0);
        ensure!(longest as f64 <= 1e6 / f64::from(hz) + 2_500.0, "{longest} µs lay between two positions at {hz} Hz");
        for axis in 0..3 {
            let trace = board.world.axes[axis].lock().expect("turns");
            let wanted = steps_in(axis, target - from);
            ensure!(
                trace.rises().count() == wanted,
                "axis {axis}: {} steps instead of {wanted}",
                trace.rises().count()
            );
        }
        ensure!(status.in_position && status.stopped.is_none(), "it was stopped: {:?}", status.stopped);
        said.push(rate);
    }
    board.stop()?.clean()?;
    Ok(format!("{:.1} and {:.1} positions a second beside a move of three axes, no step missed", said[0], said[1]))
}

/// Steps of a distance on one of these axes.
fn steps_in(axis: usize, distance_um: i32) -> usize {
    settings()[axis].steps_per_um.steps(Nanometres(distance_um.abs() * 1000)).0 as usize
}

/// Greatest difference between an axis' edges, STEP and DIR, and their plan, counted from the first STEP edge of each.
pub(super) fn compare(axis: usize, trace: &Trace, plan: &[Change]) -> anyhow::Result<u64> {
    let first = plan.iter().find(|c| c.axis == axis && c.step).map_or(0, |c| c.tick) as i64;
    let began = trace.step.first().map_or(0, |e| e.tick) as i64;
    let mut worst = 0;
    for (name, step, edges) in [("STEP", true, &trace.step), ("DIR", false, &trace.dir)] {
        let planned: Vec<_> = plan.iter().filter(|c| c.axis == axis && c.step == step).collect();
        ensure!(
            planned.len() == edges.len(),
            "axis {axis} {name}: {} edges came out of {} planned",
            edges.len(),
            planned.len()
        );
        for (planned, edge) in planned.iter().zip(edges) {
            ensure!(planned.high == edge.high, "axis {axis} {name}: an edge goes the wrong way at tick {}", edge.tick);
            worst = worst.max(((planned.tick as i64 - first) - (edge.tick as i64 - began)).unsigned_abs());
        }
    }
    Ok(worst)
}

/// Greatest distance of a single-axis move's steps from the exact profile of its settings, ticks; the begin of the path is
/// where it fits best.
fn off_exact(trace: &Trace, settings: &AxisSettings, speed: Option<MicrometresPerSecond>) -> anyhow::Result<f64> {
    let rises: Vec<u64> = trace.rises().collect();
    let mut settings = *settings;
    settings.speed = speed.unwrap_or(settings.speed);
    let limits = in_ticks(&settings);
    let length = rises.len() as f64;
    // Durations in whole ticks, from the limits; everything else of the path follows from them exactly.
    let jerk = (limits.a / limits.j).ceil().max(1.0);
    let hold = (limits.v / limits.a - limits.a / limits.j).ceil().max(0.0);
    let cruise = ((length - limits.v * (2.0 * limits.a / limits.j + (limits.v / limits.a - limits.a / limits.j)))
        / limits.v)
        .ceil();
    ensure!(cruise > 0.0, "the move is too short to cruise: choose another one to compare");
    let exact = Exact { length: rises.len() as u32, ticks: [jerk as u64, hold as u64, cruise as u64] };
    let off = rises.iter().zip(1..).map(|(tick, step)| (tick * FINE) as i64 - exact.edge(step) as i64);
    Ok(fitted(off))
}
