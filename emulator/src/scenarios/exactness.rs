//! Lines of several axes, single and both edges side by side, and vibrations, held against exact formulas: what the scenario
//! `edges` shows of one axis with single edges.

use super::{axis_settings, connect, rest};
use crate::exact::{Exact, FINE, fitted};
use crate::figures::Figures;
use crate::planned::Planned;
use crate::talk::Link;
use crate::trace::Trace;
use anyhow::{anyhow, ensure};
use parfocal_firmware::motion::limits::in_ticks;
use parfocal_protocol::message::Request;
use parfocal_protocol::settings::{AxisSettings, Driver, Edges};
use parfocal_protocol::units::{
    Axis, Hertz, MicrometresPerSecond, MicrometresPerSecond2, MicrometresPerSecond3, Nanometres, StepsPerMicrometre,
};
use std::f64::consts::TAU;
use std::path::Path;
use std::time::Duration;

/// Ticks a second.
const TICKS: f64 = crate::trace::TICK_HZ as f64;

/// The vibration: steps from the middle to a turning point, Hz, cycles.
const AMPLITUDE: u32 = 120;
const FREQUENCY: f32 = 17.0;
const CYCLES: u16 = 3;

/// Alike but for their edges: the longest way then rules all axes, and its durations are everybody's. None of these is nearly a
/// whole number of ticks, so that rounding up leaves no doubt.
fn settings() -> [AxisSettings; 4] {
    std::array::from_fn(|i| AxisSettings {
        steps_per_um: StepsPerMicrometre(40.0),
        speed: MicrometresPerSecond(1_950.0),
        acceleration: MicrometresPerSecond2(41_300.0),
        jerk: MicrometresPerSecond3(3_970_000.0),
        driver: Driver::Tmc2209,
        edges: if i % 2 == 1 { Edges::Both } else { Edges::Rising },
        ..AxisSettings::default()
    })
}

/// Ticks of an axis' steps.
fn steps(trace: &Trace, edges: Edges) -> Vec<u64> {
    trace.step.iter().filter(|e| e.high || edges == Edges::Both).map(|e| e.tick).collect()
}

/// Plays them all.
///
/// # Errors
/// When an edge is missing, surplus, off its plan, or more than a tick off the exact time.
pub fn play(elf: &Path, figures: &mut Figures) -> anyhow::Result<String> {
    let (mut board, mut talk) = connect(elf, Link::Usb)?;
    let settings = settings();
    for (axis, settings) in settings.iter().enumerate() {
        axis_settings(&mut board, &mut talk, axis, *settings)?;
    }
    let mut planned = Planned::new(&settings).map_err(|r| anyhow!("refused on a PC: {r:?}"))?;
    let (mut line, mut count) = (0.0f64, 0);
    // The first one has the longest way.
    for um in [[300, 300, 210, 7], [0, 210, 300, 0]] {
        let to = um.map(|um| Some(Nanometres(um * 1000)));
        let plan = planned.move_to(&to, None).map_err(|r| anyhow!("refused on a PC: {r:?}"))?;
        board.world.axes.iter().for_each(|axis| axis.lock().expect("turns").clear_edges());
        talk.ask(&mut board, Request::Move { to, speed: None })?;
        rest(&mut board, &mut talk, Duration::from_millis(20))?;
        let all: Vec<Vec<u64>> =
            (0..4).map(|i| steps(&board.world.axes[i].lock().expect("turns"), settings[i].edges)).collect();
        let ticks = durations(&settings[0], all[0].len() as f64)?;
        for (axis, steps) in all.iter().enumerate() {
            let trace = board.world.axes[axis].lock().expect("turns");
            let jitter = super::motion::compare(axis, &trace, &plan)?;
            ensure!(jitter == 0, "axis {axis}: edges come up to {jitter} ticks off their plan");
            let exact = Exact { length: steps.len() as u32, ticks };
            let off = steps.iter().zip(1..).map(|(tick, step)| (tick * FINE) as i64 - exact.edge(step) as i64);
            line = line.max(fitted(off));
            count += steps.len();
        }
    }
    let mut vibration = 0.0f64;
    for axis in [2, 3] {
        board.world.axes[axis].lock().expect("turns").clear_edges();
        let amplitude = Nanometres((AMPLITUDE * 25) as i32);
        let request =
            Request::Vibrate { axis: Axis(axis as u8), amplitude, frequency: Hertz(FREQUENCY), cycles: CYCLES };
        talk.ask(&mut board, request)?;
        rest(&mut board, &mut talk, Duration::from_millis(20))?;
        let steps = steps(&board.world.axes[axis].lock().expect("turns"), settings[axis].edges);
        let swings = 4 * AMPLITUDE as usize * usize::from(CYCLES);
        let ways = 2 * AMPLITUDE as usize;
        ensure!(steps.len() == swings + ways, "axis {axis}: {} steps instead of {}", steps.len(), swings + ways);
        let off = (0..swings).map(|k| {
            let exact = cosine(k as u32) * FINE as f64;
            (steps[AMPLITUDE as usize + k] * FINE) as i64 - exact.round() as i64
        });
        vibration = vibration.max(fitted(off));
        count += steps.len();
    }
    board.stop()?.clean()?;
    ensure!(line <= 1.0, "edges of lines lie up to {line:.2} ticks off the exact profile");
    ensure!(vibration <= 1.0, "edges of vibrations lie up to {vibration:.2} ticks off the cosine");
    let worst = figures.profile_error_ticks.unwrap_or(0.0).max(line).max(vibration);
    figures.profile_error_ticks = Some((worst * 1000.0).round() / 1000.0);
    Ok(format!(
        "{count} steps of lines and vibrations, single and both edges: jitter 0 ticks, {line:.2} and {vibration:.2} ticks off"
    ))
}

/// Ticks of jerk, of constant acceleration, of cruise on the axis that has the longest way.
fn durations(settings: &AxisSettings, length: f64) -> anyhow::Result<[u64; 3]> {
    let limits = in_ticks(settings);
    let jerk = (limits.a / limits.j).ceil().max(1.0);
    let hold = (limits.v / limits.a - limits.a / limits.j).ceil().max(0.0);
    let cruise = (length / limits.v - limits.a / limits.j - limits.v / limits.a).ceil();
    ensure!(cruise > 0.0, "the move is too short to cruise: choose another one to compare");
    Ok([jerk, hold, cruise].map(|t| t as u64))
}

/// When the cosine makes its step `k` from 0, ticks since its top.
fn cosine(k: u32) -> f64 {
    let (half, step) = (k / (2 * AMPLITUDE), k % (2 * AMPLITUDE));
    let amplitude = f64::from(AMPLITUDE);
    let turns = f64::from(half) / 2.0 + ((amplitude - 0.5 - f64::from(step)) / amplitude).acos() / TAU;
    turns * TICKS / f64::from(FREQUENCY)
}
