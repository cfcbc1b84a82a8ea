//! Scans on curves of the bench's family, with noise: there the board fits peaks, and must not be held up by it.

use super::scans::{self, Scanned, Times};
use crate::figures::Figures;
use crate::talk::Link;
use anyhow::{Context, ensure};
use curves::Truth;
use parfocal_protocol::autofocus::Outcome;
use parfocal_protocol::settings::AxisSettings;
use parfocal_protocol::units::{
    MicrometresPerSecond, MicrometresPerSecond2, MicrometresPerSecond3, Milliseconds, Nanometres, StepsPerMicrometre,
};
use std::path::Path;

#[expect(dead_code, reason = "the bench reads files of curves, too")]
#[path = "../../../benches/src/autofocus/curves.rs"]
mod curves;
#[path = "../../../benches/src/autofocus/family.rs"]
mod family;

/// All local maxima of the family lie within this distance of the peak, µm.
const TRAP: f64 = 10.0;

/// The curves are drawn with this seed.
const SEED: u64 = 4;

/// Noise of a frame, relative to its value.
const NOISES: [f64; 3] = [0.0, 0.001, 0.01];

/// A short scan for each noise, of a narrow range.
///
/// # Errors
/// When a decision takes too long, or a scan does not end in focus.
pub fn short(elf: &Path, figures: &mut Figures) -> anyhow::Result<String> {
    let near = |curve: &&Truth| curve.r == 100.0 && (curve.z0random - curve.zstar).abs() < 15.0;
    let curves = family::curves(200, SEED).curves;
    let curves: Vec<&Truth> = curves.iter().filter(near).collect();
    let runs: Vec<(&Truth, f64)> = curves.into_iter().zip(NOISES.into_iter().skip(1)).collect();
    let (said, times) = play(elf, &runs)?;
    figures.decided(&times);
    Ok(said)
}

/// Scans of all ranges under every noise, from the middle.
///
/// # Errors
/// As [`short`].
pub fn long(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    let curves = family::curves(200, SEED).curves;
    let mut runs = Vec::new();
    for r in [100.0, 200.0, 500.0] {
        let of_this_range: Vec<&Truth> = curves.iter().filter(|c| c.r == r).take(NOISES.len()).collect();
        runs.extend(of_this_range.into_iter().zip(NOISES));
    }
    play(elf, &runs).map(|(said, _)| said)
}

fn play(elf: &Path, runs: &[(&Truth, f64)]) -> anyhow::Result<(String, Times)> {
    let (mut slowest, mut samples) = (Times::default(), 0);
    for &(curve, noise) in runs {
        let from = if noise == 0.0 { 0.0 } else { curve.z0random };
        let what = || format!("curve {}, noise {noise}", curve.id);
        let Scanned { visited, report, times } = scan(elf, curve, from, noise).with_context(what)?;
        ensure!(report.outcome == Outcome::Focused, "{}: {:?}", what(), report.outcome);
        let off = report.end.micrometres().0 + from - curve.zstar;
        ensure!(off.abs() < 1.0, "{}: {off} µm beside the peak", what());
        times.hold().with_context(what)?;
        slowest = slowest.slower(times);
        samples += visited.len();
    }
    let said = format!(
        "{samples} samples, {} scans; the board is held up for at most {:.0} µs, a decision with fits is made after {:.1} ms",
        runs.len(),
        slowest.decision_us,
        slowest.decided_ms
    );
    Ok((said, slowest))
}

/// A scan that starts `from` there; the axis' zero lies there.
fn scan(elf: &Path, curve: &Truth, from: f64, noise: f64) -> anyhow::Result<Scanned> {
    let nm = |um: f64| Nanometres((um * 1000.0).round() as i32);
    let settings = AxisSettings {
        steps_per_um: StepsPerMicrometre(100.0),
        speed: MicrometresPerSecond(1000.0),
        acceleration: MicrometresPerSecond2(100_000.0),
        jerk: MicrometresPerSecond3(100_000_000.0),
        low: nm(-curve.r - from),
        high: nm(curve.r - from),
        settling: Milliseconds(0),
        ..AxisSettings::default()
    };
    scans::play(elf, Link::Usb, settings, |k, z| curve.frame(k, z.micrometres().0 + from, noise))
}
