//! A scan for focus: the board decides every move. It visits the places that the simulator and a serial port give
//! (`tests/golden/scan.json`, which `tests/tests/pty.rs` holds them to).

use super::scans::{self, Scanned};
use crate::figures::Figures;
use crate::talk::Link;
use anyhow::{Context, ensure};
use parfocal_protocol::autofocus::Outcome;
use parfocal_protocol::settings::AxisSettings;
use parfocal_protocol::units::{
    MicrometresPerSecond, MicrometresPerSecond2, MicrometresPerSecond3, Milliseconds, Nanometres, StepsPerMicrometre,
};
use std::path::Path;

const CURVE: &str = include_str!("../../../tests/golden/curve.csv");
const SCAN: &str = include_str!("../../../tests/golden/scan.json");

/// A scan over USB.
///
/// # Errors
/// When it visits other places, or does not end in focus.
pub fn over_usb(elf: &Path, figures: &mut Figures) -> anyhow::Result<String> {
    let Scanned { visited, report, times } = scan(elf, Link::Usb)?;
    times.hold()?;
    figures.decided(&times);
    Ok(format!(
        "{} samples, focus at {} µm; at most {:.0} µs for a decision (the last one left and taken up again for {:.1} ms), \
         {:.0} µs with the move planned, {:.2} ms for an answer",
        visited.len(),
        report.end.micrometres().0,
        times.decision_us,
        times.judged_ms,
        times.planned_us,
        times.answer_ms
    ))
}

/// The same over USART3.
///
/// # Errors
/// As [`over_usb`].
pub fn over_serial(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    let Scanned { visited, report, .. } = scan(elf, Link::Serial)?;
    Ok(format!("{} samples, focus at {} µm", visited.len(), report.end.micrometres().0))
}

fn scan(elf: &Path, link: Link) -> anyhow::Result<Scanned> {
    let points = curve()?;
    // The virtual microscope's focus (simulator/src/model.rs), with the curve's extent for its limits.
    let settings = AxisSettings {
        steps_per_um: StepsPerMicrometre(100.0),
        speed: MicrometresPerSecond(1000.0),
        acceleration: MicrometresPerSecond2(20_000.0),
        jerk: MicrometresPerSecond3(2_000_000.0),
        low: Nanometres(-60_000),
        high: Nanometres(60_000),
        settling: Milliseconds(15),
        ..AxisSettings::default()
    };
    let scanned = scans::play(elf, link, settings, |_, z| between(&points, z.micrometres().0))?;
    ensure!(scanned.report.outcome == Outcome::Focused, "the scan ended with {:?}", scanned.report.outcome);
    let expected: Vec<i32> = serde_json::from_str(SCAN)?;
    ensure!(scanned.visited == expected, "the board visited {:?}, the simulator {expected:?} nm", scanned.visited);
    Ok(scanned)
}

/// The points of the curve: z in µm, Φ.
fn curve() -> anyhow::Result<Vec<(f64, f64)>> {
    CURVE
        .lines()
        .skip(1)
        .map(|line| {
            let (z, phi) = line.split_once(',').with_context(|| format!("'{line}' is no point"))?;
            Ok((z.parse()?, phi.parse()?))
        })
        .collect()
}

/// As the host interpolates: see host/src/frames/curve.rs.
fn between(points: &[(f64, f64)], z: f64) -> f64 {
    let above = points.partition_point(|p| p.0 <= z).max(1);
    let (z0, phi0) = points[above - 1];
    points.get(above).map_or(phi0, |(z1, phi1)| phi0 + (phi1 - phi0) * (z - z0) / (z1 - z0))
}
