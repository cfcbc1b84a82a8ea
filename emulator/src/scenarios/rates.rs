//! How fast steps can come, and what they cost: whole moves at the top rate, ramps included, with telemetry and requests
//! going on beside them.
//!
//! Two budgets bound a rate. The core: instructions × 1.5 + 24 cycles for every run of the step interrupt, of the cycles
//! until the next. The DMA: 0.5 µs a record on its bus, axes added up. The smaller one counts.

use super::beside::Beside;
use super::{axis_settings, connect};
use crate::figures::Figures;
use crate::service::{Service, services, watch};
use crate::talk::Link;
use crate::trace::TICK_HZ;
use anyhow::ensure;
use parfocal_firmware::motion::limits::RECORDS_PER_SECOND;
use parfocal_protocol::message::Request;
use parfocal_protocol::settings::{AxisSettings, Driver, Edges};
use parfocal_protocol::units::{
    MicrometresPerSecond, MicrometresPerSecond2, MicrometresPerSecond3, Nanometres, StepsPerMicrometre,
};
use std::path::Path;

/// Steps in a µm: many, so that speeds in µm/s stay sensible.
const SCALE: f64 = 400.0;

/// How long the top speed lasts, s.
const CRUISE: f64 = 0.015;

/// What a run at the top rate brought.
struct Run {
    /// Steps a second, all axes together, up to which every run of the interrupt fitted into its own time: the top rate, or
    /// the rate in the ramp at which the first did not.
    sustained: f64,
    /// Part of its period that the interrupt takes: on average at constant speed, and at most in the whole move.
    load: [f64; 2],
    /// Instructions a step at constant speed, all of the interrupt divided by the steps of that time.
    cruise: f64,
    /// The same while speeding up.
    ramp: f64,
    /// What went on beside it.
    beside: Beside,
}

/// Most instructions that a step may take, single edge on one axis (a record a step), in cruise and in ramps. The interrupt's
/// whole cost is in it, idle axes included. Lower them when a step gets cheaper; a change that needs more says why.
const MOST: [f64; 2] = [26.0, 50.0];

/// The same for both edges, two of which make a record.
const MOST_EDGE: [f64; 2] = [15.0, 30.0];

/// Bounds kept, or which is not.
fn bounded(what: &str, run: &Run, most: [f64; 2]) -> anyhow::Result<()> {
    ensure!(run.cruise <= most[0], "{what} takes {:.1} instructions in cruise, more than {}", run.cruise, most[0]);
    ensure!(run.ramp <= most[1], "{what} takes {:.1} instructions in ramps, more than {}", run.ramp, most[1]);
    Ok(())
}

/// One axis alone, single edge and both edges: what a step costs, and the rate that one axis sustains.
///
/// # Errors
/// When a run goes wrong, steps are lost, or a step costs more than it may.
pub fn cost(elf: &Path, figures: &mut Figures) -> anyhow::Result<String> {
    let single = run(elf, 1, Edges::Rising)?;
    figures.single_edge_steps_per_s_1_axis = Some(single.sustained.round() as u64);
    figures.instructions_per_step_cruise = Some(round(single.cruise));
    figures.instructions_per_step_ramp = Some(round(single.ramp));
    bounded("a step", &single, MOST)?;
    Ok(format!(
        "{:.1} instructions a step and record in cruise, {:.1} in ramps; {:.2} M/s with single edges, {}",
        single.cruise,
        single.ramp,
        single.sustained / 1e6,
        single.beside
    ))
}

/// The other rates: both edges, several axes.
///
/// # Errors
/// As [`cost`].
pub fn play(elf: &Path, figures: &mut Figures) -> anyhow::Result<String> {
    let both_1 = run(elf, 1, Edges::Both)?;
    figures.edges_per_s_1_axis = Some(both_1.sustained.round() as u64);
    figures.instructions_per_edge_cruise = Some(round(both_1.cruise));
    figures.instructions_per_edge_ramp = Some(round(both_1.ramp));
    figures.service_load_1_axis = Some(round(both_1.load[1]));
    let both_3 = run(elf, 3, Edges::Both)?;
    figures.edges_per_s_3_axes = Some(both_3.sustained.round() as u64);
    figures.service_load_3_axes = Some(round(both_3.load[1]));
    let single_3 = run(elf, 3, Edges::Rising)?;
    figures.single_edge_steps_per_s_3_axes = Some(single_3.sustained.round() as u64);
    bounded("an edge", &both_1, MOST_EDGE)?;
    Ok(format!(
        "both edges {:.3} M/s on one axis, {:.3} M/s on three; single edge {:.3} M/s on three; {:.1} instructions an edge in cruise, {:.1} in ramps (a record has two); the interrupt takes {:.2} and {:.2} of its time at constant speed, {:.2} and {:.2} at most; {}",
        both_1.sustained / 1e6,
        both_3.sustained / 1e6,
        single_3.sustained / 1e6,
        both_1.cruise,
        both_1.ramp,
        both_1.load[0],
        both_3.load[0],
        both_1.load[1],
        both_3.load[1],
        both_1.beside
    ))
}

fn round(x: f64) -> f64 {
    (x * 100.0).round() / 100.0
}

/// Settings for the top rate that `axes` axes can have together.
fn settings(axes: usize, edges: Edges) -> (AxisSettings, f64) {
    let per_record = if edges == Edges::Both { 2.0 } else { 1.0 };
    let fastest = parfocal_firmware::motion::limits::fastest(&AxisSettings {
        driver: Driver::Tmc2209,
        edges,
        ..AxisSettings::default()
    });
    // A hair below, for the settings are told in 32-bit floats.
    let rate = fastest.min(RECORDS_PER_SECOND * per_record / axes as f64) * 0.9999;
    let speed = rate / SCALE;
    // Full speed within 0.2 s, full acceleration within 2 ms.
    let acceleration = (parfocal_firmware::motion::limits::ACCELERATION / SCALE).min(speed / 0.05) * 0.999;
    let settings = AxisSettings {
        steps_per_um: StepsPerMicrometre(SCALE as f32),
        speed: MicrometresPerSecond(speed as f32),
        acceleration: MicrometresPerSecond2(acceleration as f32),
        jerk: MicrometresPerSecond3((acceleration / 0.002) as f32),
        high: Nanometres(2_000_000_000),
        home_speed: MicrometresPerSecond((speed / 10.0) as f32),
        driver: Driver::Tmc2209,
        edges,
        ..AxisSettings::default()
    };
    (settings, speed)
}

fn run(elf: &Path, axes: usize, edges: Edges) -> anyhow::Result<Run> {
    let (mut board, mut talk) = connect(elf, Link::Usb)?;
    let (settings, speed) = settings(axes, edges);
    for axis in 0..axes {
        axis_settings(&mut board, &mut talk, axis, settings)?;
    }
    talk.ask(&mut board, Request::SetBoard { settings: Beside::settings() })?;
    watch(&board)?;
    // Both ramps, and the cruise.
    let ramps = speed * (speed / f64::from(settings.acceleration.0) + 0.002);
    let target = Nanometres(((ramps + speed * CRUISE) * 1000.0) as i32);
    let to = std::array::from_fn(|axis| (axis < axes).then_some(target));
    talk.ask(&mut board, Request::Move { to, speed: None })?;
    let (status, beside) = Beside::of(&mut board, &mut talk)?;
    ensure!(status.stopped.is_none(), "it was stopped: {:?}", status.stopped);
    ensure!(beside.telemetry_hz() >= 100.0, "positions were told only {:.1} times a second", beside.telemetry_hz());
    let expected = settings.steps_per_um.steps(target).0;
    for axis in 0..axes {
        let trace = board.world.axes[axis].lock().expect("turns");
        let counted = if edges == Edges::Both { trace.step.len() } else { trace.rises().count() };
        ensure!(counted == expected as usize, "axis {axis}: {counted} steps came out instead of {expected}");
        ensure!(status.axes[axis].steps.0 == expected, "axis {axis} tells {} steps", status.axes[axis].steps.0);
    }
    let (began, ended) = {
        let trace = board.world.axes[0].lock().expect("turns");
        (trace.step.first().map_or(0, |e| e.tick), trace.step.last().map_or(0, |e| e.tick))
    };
    let entry = board.program.address("SysTick")?;
    let world = board.world.clone();
    let report = board.stop()?;
    report.clean()?;
    let all = services(entry, &report.hits)?;
    let trace = world.axes[0].lock().expect("turns");
    let tick = |s: &Service| trace.tick(rigless::time::VirtualNanos(s.nanos));
    let steps_between = |from: u64, to: u64| {
        let edges_in = trace.step.iter().filter(|e| e.tick >= from && e.tick < to);
        let one = if edges == Edges::Both { edges_in.count() } else { edges_in.filter(|e| e.high).count() };
        one * axes
    };
    let instructions = |from: u64, to: u64| -> u64 {
        all.iter().filter(|s| (from..to).contains(&tick(s))).map(|s| s.instructions).sum()
    };
    let per_step = |from: u64, to: u64| instructions(from, to) as f64 / steps_between(from, to).max(1) as f64;
    // A move is as long on its way up as on its way down: the middle is cruise.
    let (middle, part) = (began.midpoint(ended), (CRUISE * TICK_HZ as f64 / 3.0) as u64);
    let (from, to) = (middle - part, middle + part);
    let rate = |from: u64, to: u64| steps_between(from, to) as f64 / ((to - from).max(1) as f64 / TICK_HZ as f64);
    let moving = |s: &&Service| tick(s) >= began && tick(s) < ended;
    // The interrupt works ahead, and the rate is that of the ms before. On the way down, too, every run has to fit.
    let too_much = all.iter().filter(moving).find(|s| s.load() > 1.0).map(tick);
    let sustained =
        too_much.map_or(rate(from, to), |at| rate(at.saturating_sub(TICK_HZ / 1000), at).min(rate(from, to)));
    let most = all.iter().filter(moving).map(Service::load).fold(0.0, f64::max);
    let cruising: Vec<f64> = all.iter().filter(|s| (from..to).contains(&tick(s))).map(Service::load).collect();
    Ok(Run {
        sustained,
        load: [cruising.iter().sum::<f64>() / cruising.len().max(1) as f64, most],
        cruise: per_step(from, to),
        ramp: per_step(began, from),
        beside,
    })
}
