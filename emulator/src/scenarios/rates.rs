//! How fast steps can come, and what they cost: whole moves at the top rate, ramps included, with telemetry and requests
//! going on beside them.
//!
//! Two budgets bound a rate. The core: instructions × 1.5 + 24 cycles for every run of the step interrupt, of the cycles
//! until the next. The DMA: 0.5 µs a record on its bus, axes added up. The smaller one counts.

use super::{axis_settings, connect, rest};
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
use std::time::Duration;

/// Steps in a µm: many, so that speeds in µm/s stay sensible.
const SCALE: f64 = 400.0;

/// What a run at the top rate brought.
struct Run {
    /// Steps a second, all axes together, up to which every run of the interrupt fitted into its own time: the top rate, or
    /// the rate in the ramp at which the first did not.
    sustained: f64,
    /// Mean part of its period that the interrupt takes at constant speed.
    load: f64,
    /// Instructions a step at constant speed, all of the interrupt divided by the steps of that time.
    cruise: f64,
    /// The same while speeding up.
    ramp: f64,
}

/// All rates and costs.
///
/// # Errors
/// When a run goes wrong or steps are lost.
pub fn play(elf: &Path, figures: &mut Figures) -> anyhow::Result<String> {
    let both_1 = run(elf, 1, Edges::Both)?;
    let both_3 = run(elf, 3, Edges::Both)?;
    let single_1 = run(elf, 1, Edges::Rising)?;
    let single_3 = run(elf, 3, Edges::Rising)?;
    figures.edges_per_s_1_axis = Some(both_1.sustained.round() as u64);
    figures.edges_per_s_3_axes = Some(both_3.sustained.round() as u64);
    figures.single_edge_steps_per_s_1_axis = Some(single_1.sustained.round() as u64);
    figures.single_edge_steps_per_s_3_axes = Some(single_3.sustained.round() as u64);
    figures.instructions_per_step_cruise = Some(round(single_1.cruise));
    figures.instructions_per_step_ramp = Some(round(single_1.ramp));
    figures.instructions_per_edge_cruise = Some(round(both_1.cruise));
    figures.service_load_1_axis = Some(round(both_1.load));
    figures.service_load_3_axes = Some(round(both_3.load));
    Ok(format!(
        "both edges {:.2} M/s on one axis, {:.2} M/s on three; single edge {:.2} and {:.2} M/s; {:.1} instructions a step in cruise, {:.1} in ramps; interrupt load {:.2}, {:.2}",
        both_1.sustained / 1e6,
        both_3.sustained / 1e6,
        single_1.sustained / 1e6,
        single_3.sustained / 1e6,
        single_1.cruise,
        single_1.ramp,
        both_1.load,
        both_3.load
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
    watch(&board)?;
    // Both ramps, and 15 ms of cruise.
    let ramps = speed * (speed / f64::from(settings.acceleration.0) + 0.002);
    let target = Nanometres(((ramps + speed * 0.015) * 1000.0) as i32);
    let to = std::array::from_fn(|axis| (axis < axes).then_some(target));
    talk.ask(&mut board, Request::Move { to, speed: None })?;
    // A scan's traffic: a request every few ms, beside the telemetry.
    let status = rest(&mut board, &mut talk, Duration::from_millis(5))?;
    let expected = settings.steps_per_um.steps(target).0;
    let mut top = (0, 0);
    for axis in 0..axes {
        let trace = board.world.axes[axis].lock().expect("turns");
        let counted = if edges == Edges::Both { trace.step.len() } else { trace.rises().count() };
        ensure!(counted == expected as usize, "axis {axis}: {counted} steps came out instead of {expected}");
        ensure!(status.axes[axis].steps.0 == expected, "axis {axis} tells {} steps", status.axes[axis].steps.0);
        if axis == 0 {
            // Constant speed: where a record is no longer than the shortest, and one tick.
            let between: Vec<u64> = trace.updates.windows(2).map(|w| w[1] - w[0]).collect();
            let records: Vec<usize> = (0..between.len()).filter(|i| steps_at(&trace, *i)).collect();
            let shortest = records.iter().map(|i| between[*i]).min().unwrap_or(0);
            let fast: Vec<usize> = records.into_iter().filter(|i| between[*i] <= shortest + 1).collect();
            if let (Some(first), Some(last)) = (fast.first(), fast.last()) {
                top = (trace.updates[*first], trace.updates[*last]);
            }
        }
    }
    let began = board.world.axes[0].lock().expect("turns").step.first().map_or(0, |e| e.tick);
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
    let (from, to) = top;
    let rate = |from: u64, to: u64| steps_between(from, to) as f64 / ((to - from).max(1) as f64 / TICK_HZ as f64);
    // The interrupt works ahead, and the rate is that of the ms before.
    let too_much = all.iter().find(|s| tick(s) > began && s.load() > 1.0).map(tick);
    let sustained = match too_much {
        Some(at) if at < to => rate(at.saturating_sub(TICK_HZ / 1000), at),
        _ => rate(from, to),
    };
    let cruising: Vec<f64> = all.iter().filter(|s| (from..to).contains(&tick(s))).map(Service::load).collect();
    Ok(Run {
        sustained,
        load: cruising.iter().sum::<f64>() / cruising.len().max(1) as f64,
        cruise: per_step(from, to),
        ramp: per_step(began, from),
    })
}

/// Whether STEP changes in the record that begins with an update.
fn steps_at(trace: &crate::trace::Trace, update: usize) -> bool {
    let (from, to) = (trace.updates[update], trace.updates[update + 1]);
    let at = trace.step.partition_point(|e| e.tick < from);
    trace.step.get(at).is_some_and(|e| e.tick < to)
}
