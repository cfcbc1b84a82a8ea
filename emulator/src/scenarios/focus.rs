//! A scan for focus: the board decides every move. It visits the places that the simulator and a serial port give
//! (`tests/golden/scan.json`, which `tests/tests/pty.rs` holds them to).

use super::{axis_settings, connect};
use crate::figures::Figures;
use crate::talk::Link;
use anyhow::{Context, bail, ensure};
use parfocal_protocol::autofocus::{
    FocusSample, Mode, Outcome, SampleWanted, ScanId, ScanParameters, ScanState, Strategy, Subject,
};
use parfocal_protocol::message::{Event, Request, Response};
use parfocal_protocol::settings::AxisSettings;
use parfocal_protocol::units::{
    Axis, FocusValue, MicrometresPerSecond, MicrometresPerSecond2, MicrometresPerSecond3, Milliseconds, Nanometres,
    StepsPerMicrometre,
};
use std::path::Path;
use std::time::Duration;

const CURVE: &str = include_str!("../../../tests/golden/curve.csv");
const SCAN: &str = include_str!("../../../tests/golden/scan.json");

/// The axis that focuses.
const Z: Axis = Axis(2);

/// A scan over USB.
///
/// # Errors
/// When it visits other places, or does not end in focus.
pub fn over_usb(elf: &Path, figures: &mut Figures) -> anyhow::Result<String> {
    let (said, times) = scan(elf, Link::Usb)?;
    ensure!(times.decision_us < DECISION_US, "a decision took {:.0} µs, {DECISION_US} are allowed", times.decision_us);
    ensure!(
        times.planned_us < PLANNED_US,
        "deciding and planning took {:.0} µs, {PLANNED_US} are allowed",
        times.planned_us
    );
    ensure!(times.answer_ms < ANSWER_MS, "an answer took {:.2} ms, {ANSWER_MS} are allowed", times.answer_ms);
    figures.sample_decision_us = Some((times.decision_us * 10.0).round() / 10.0);
    figures.sample_to_move_us = Some((times.planned_us * 10.0).round() / 10.0);
    figures.sample_round_trip_ms = Some((times.answer_ms * 1000.0).round() / 1000.0);
    Ok(said)
}

/// Longest time that the board may take to decide after a sample, µs; the interrupts in between count.
const DECISION_US: f64 = 200.0;

/// Longest time until the next move is planned, too, and the answer queued, µs.
const PLANNED_US: f64 = 2000.0;

/// Longest time from a sample sent over USB to the answer, by when the next move is decided, ms.
const ANSWER_MS: f64 = 2.0;

/// Cycles that an instruction takes on silicon; the emulation counts one.
const CYCLES_PER_INSTRUCTION: f64 = 1.5;

/// How long the slowest sample took.
struct Times {
    /// The board's decision: from the sample in its hands to where the next one is wanted.
    decision_us: f64,
    /// After the last sample: from it to where the focus is.
    judgement_us: f64,
    /// The same until that move is planned and begun, and the answer in the queue.
    planned_us: f64,
    /// The whole way there and back.
    answer_ms: f64,
}

/// The same over USART3.
///
/// # Errors
/// As [`over_usb`].
pub fn over_serial(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    scan(elf, Link::Serial).map(|(said, _)| said)
}

fn scan(elf: &Path, link: Link) -> anyhow::Result<(String, Times)> {
    let points = curve()?;
    let (mut board, mut talk) = connect(elf, link)?;
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
    axis_settings(&mut board, &mut talk, 2, settings)?;
    let parameters = ScanParameters {
        scan: ScanId(1),
        axis: Z,
        strategy: Strategy::Climb,
        mode: Mode::Step,
        subject: Subject::Peak,
        low: settings.low,
        high: settings.high,
        sample_step: Nanometres(500),
        trap: Nanometres(10_000),
        probe: Nanometres(5_000),
        speed: MicrometresPerSecond(0.0),
        sample_timeout: Milliseconds(2000),
        verify: false,
    };
    let taken = board.program.address("parfocal_firmware::focusing::Focusing::sample")?;
    let answers = board.program.address("parfocal_firmware::board::links::Bytes::send")?;
    let moves = board
        .program
        .address("parfocal_firmware::motion::moves::<impl parfocal_firmware::motion::facade::Motion>::move_to")?;
    board.watch_instruction(moves);
    board.watch_instruction(taken);
    board.watch_instruction(answers);
    let mut state = scan_state(talk.ask(&mut board, Request::AutofocusStart(parameters))?)?;
    let (mut visited, mut answered, mut slowest) = (Vec::new(), None, Duration::ZERO);
    let report = loop {
        match state {
            ScanState::Ended(report) => break report,
            ScanState::Waiting(SampleWanted { scan, index, z, .. }) if answered != Some(index) => {
                answered = Some(index);
                visited.push(z.0);
                let value = Ok(FocusValue(between(&points, z.micrometres().0)));
                let asked = board.now();
                let sample = FocusSample { scan, index, value };
                state = scan_state(talk.ask(&mut board, Request::AutofocusSample(sample))?)?;
                slowest = slowest.max(board.now() - asked);
            }
            _ => {
                state = talk.until(&mut board, Duration::from_secs(2), |event| match event {
                    Event::SampleWanted(wanted) => Some(ScanState::Waiting(*wanted)),
                    Event::ScanEnded(report) => Some(ScanState::Ended(*report)),
                    _ => None,
                })?;
            }
        }
    };
    let finished = board.stop()?;
    finished.clean()?;
    ensure!(report.outcome == Outcome::Focused, "the scan ended with {:?}", report.outcome);
    let expected: Vec<i32> = serde_json::from_str(SCAN)?;
    ensure!(visited == expected, "the board visited {visited:?}, the simulator {expected:?} nm");
    let (mut decided, mut planned) = (Vec::new(), Vec::new());
    for (i, begin) in finished.hits.iter().enumerate().filter(|(_, hit)| hit.address == taken) {
        let next: Vec<_> = finished.hits[i + 1..].iter().take_while(|hit| hit.address != taken).collect();
        let instructions =
            |at: u64| next.iter().find(|hit| hit.address == at).map(|hit| hit.instructions - begin.instructions);
        let answered = instructions(answers).context("a sample without an answer")?;
        planned.push(answered);
        // Without a move the answer says it all.
        decided.push(instructions(moves).filter(|n| *n < answered).unwrap_or(answered));
    }
    ensure!(planned.len() >= visited.len(), "{} decisions were seen for {} samples", planned.len(), visited.len());
    // The last one judges the whole curve, once a scan.
    let judgement = decided.pop().unwrap_or(0);
    let us = |counts: &[u64]| {
        let most = counts.iter().copied().max().unwrap_or(0);
        most as f64 * CYCLES_PER_INSTRUCTION / (crate::chip::CORE_HZ as f64 / 1e6)
    };
    let times = Times {
        decision_us: us(&decided),
        judgement_us: us(&[judgement]),
        planned_us: us(&planned),
        answer_ms: slowest.as_secs_f64() * 1e3,
    };
    let said = format!(
        "{} samples, focus at {} µm; at most {:.0} µs for a decision ({:.0} µs for the last), {:.0} µs with the move planned, {:.2} ms for an answer",
        visited.len(),
        report.end.micrometres().0,
        times.decision_us,
        times.judgement_us,
        times.planned_us,
        times.answer_ms
    );
    Ok((said, times))
}

fn scan_state(response: Response) -> anyhow::Result<ScanState> {
    match response {
        Response::Scan(state) => Ok(state),
        other => bail!("a scan was answered with {other:?}"),
    }
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
