//! One scan for focus on the emulated board, sample by sample, and what its decisions take.

use super::{axis_settings, connect};
use crate::machine::Report;
use crate::program::Program;
use crate::talk::Link;
use anyhow::{Context, bail, ensure};
use parfocal_protocol::autofocus::{
    FocusSample, Mode, SampleWanted, ScanId, ScanParameters, ScanReport, ScanState, Strategy, Subject,
};
use parfocal_protocol::message::{Event, Request, Response};
use parfocal_protocol::settings::AxisSettings;
use parfocal_protocol::units::{Axis, FocusValue, MicrometresPerSecond, Milliseconds, Nanometres};
use std::path::Path;
use std::time::Duration;

/// Longest time that the board may take to decide after a sample, or to go on with a decision that takes longer, µs; the
/// interrupts in between count.
const DECISION_US: f64 = 200.0;

/// Longest time until the next move is planned, too, µs.
const PLANNED_US: f64 = 2000.0;

/// Longest time from a sample sent over USB to the answer, ms.
const ANSWER_MS: f64 = 2.0;

/// Cycles that an instruction takes on silicon; the emulation counts one.
const CYCLES_PER_INSTRUCTION: f64 = 1.5;

/// The axis that focuses.
const Z: Axis = Axis(2);

/// How long the slowest decisions took.
#[derive(Clone, Copy, Debug, Default)]
pub struct Times {
    /// The board held up: from a sample in its hands to where the next one is wanted, or to where it leaves the decision and
    /// takes it up again.
    pub decision_us: f64,
    /// From a sample to the decision, however often it was left.
    pub decided_ms: f64,
    /// After the last sample: from it to where the focus is.
    pub judged_ms: f64,
    /// From a sample in its hands to its answer queued: the next move is planned and begun, or the decision left.
    pub planned_us: f64,
    /// From a sample sent to its answer, the way there and back.
    pub answer_ms: f64,
}

impl Times {
    /// The slower of each.
    pub fn slower(self, other: Self) -> Self {
        Self {
            decision_us: self.decision_us.max(other.decision_us),
            decided_ms: self.decided_ms.max(other.decided_ms),
            judged_ms: self.judged_ms.max(other.judged_ms),
            planned_us: self.planned_us.max(other.planned_us),
            answer_ms: self.answer_ms.max(other.answer_ms),
        }
    }

    /// # Errors
    /// When one is longer than it may be.
    pub fn hold(&self) -> anyhow::Result<()> {
        let Self { decision_us, planned_us, answer_ms, .. } = self;
        ensure!(*decision_us < DECISION_US, "a decision took {decision_us:.0} µs, {DECISION_US} are allowed");
        ensure!(*planned_us < PLANNED_US, "deciding and planning took {planned_us:.0} µs, {PLANNED_US} are allowed");
        ensure!(*answer_ms < ANSWER_MS, "an answer took {answer_ms:.2} ms, {ANSWER_MS} are allowed");
        Ok(())
    }
}

/// A scan and its end.
#[derive(Debug)]
pub struct Scanned {
    /// Where samples were wanted, nm.
    pub visited: Vec<i32>,
    /// What the board told at the end.
    pub report: ScanReport,
    /// What its decisions took.
    pub times: Times,
}

/// A climb from 0 in steps of half a micrometre over the axis' whole range.
pub fn climb(settings: &AxisSettings) -> ScanParameters {
    ScanParameters {
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
    }
}

/// Plays a scan; `value` is told the number of the frame and where it is taken.
///
/// # Errors
/// When the board does not answer as it should.
pub fn play(
    elf: &Path,
    link: Link,
    settings: AxisSettings,
    mut value: impl FnMut(u32, Nanometres) -> f64,
) -> anyhow::Result<Scanned> {
    let (mut board, mut talk) = connect(elf, link)?;
    axis_settings(&mut board, &mut talk, 2, settings)?;
    let places = Places::new(&board.program)?;
    for place in [places.taken, places.thought, places.moves, places.answers] {
        board.watch_instruction(place);
    }
    let mut state = scan_state(talk.ask(&mut board, Request::AutofocusStart(climb(&settings)))?)?;
    let (mut visited, mut answered, mut slowest) = (Vec::new(), None, Duration::ZERO);
    let report = loop {
        match state {
            ScanState::Ended(report) => break report,
            ScanState::Waiting(SampleWanted { scan, index, z, .. }) if answered != Some(index) => {
                answered = Some(index);
                let value = Ok(FocusValue(value(visited.len() as u32, z)));
                visited.push(z.0);
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
    ensure!(finished.resets.is_empty(), "the board was reset: {:?}", finished.resets);
    let times = Times { answer_ms: slowest.as_secs_f64() * 1e3, ..places.times(&finished, visited.len())? };
    Ok(Scanned { visited, report, times })
}

/// Where the program passes.
struct Places {
    /// A sample is taken in.
    taken: u64,
    /// A decision is taken up again.
    thought: u64,
    /// The decision is made.
    moves: u64,
    /// Something is queued for the host.
    answers: u64,
}

impl Places {
    fn new(program: &Program) -> anyhow::Result<Self> {
        Ok(Self {
            taken: program.address("parfocal_firmware::focusing::Focusing::sample")?,
            thought: program.address("parfocal_firmware::autofocus::scan::Scan::think")?,
            moves: program.address(
                "parfocal_firmware::motion::moves::<impl parfocal_firmware::motion::facade::Motion>::move_to",
            )?,
            answers: program.address("parfocal_firmware::board::links::Bytes::send")?,
        })
    }

    fn times(&self, finished: &Report, samples: usize) -> anyhow::Result<Times> {
        let us = |instructions: u64| instructions as f64 * CYCLES_PER_INSTRUCTION / (crate::chip::CORE_HZ as f64 / 1e6);
        let mut times = Times::default();
        let mut decisions = 0;
        let hits = &finished.hits;
        for (i, sample) in hits.iter().enumerate().filter(|(_, hit)| hit.address == self.taken) {
            let answer = hits[i + 1..].iter().find(|hit| hit.address == self.answers);
            let answer = answer.context("a sample without an answer")?;
            times.planned_us = times.planned_us.max(us(answer.instructions - sample.instructions));
            // Each passage ends with the next one: a move that begins or a decision that is taken up again.
            let mut from = sample.instructions;
            for hit in hits[i + 1..].iter().filter(|hit| hit.address != self.answers) {
                ensure!(hit.address != self.taken, "a sample came before the decision about the one before it");
                times.decision_us = times.decision_us.max(us(hit.instructions - from));
                from = hit.instructions;
                if hit.address == self.moves {
                    break;
                }
            }
            times.judged_ms = us(from - sample.instructions) / 1e3;
            times.decided_ms = times.decided_ms.max(times.judged_ms);
            decisions += 1;
        }
        ensure!(decisions >= samples, "{decisions} decisions were seen for {samples} samples");
        Ok(times)
    }
}

fn scan_state(response: Response) -> anyhow::Result<ScanState> {
    match response {
        Response::Scan(state) => Ok(state),
        other => bail!("a scan was answered with {other:?}"),
    }
}
