//! The loop of a scan: start it, answer what the board asks for, stream while it sweeps, until it ends.

use super::source::{FocusSource, Frames, Judged, SourceError, Wanted};
use crate::clock::{ClockModel, Exchange};
use crate::link::transport::later;
use crate::link::{Link, LinkError};
use crate::stage::status;
use parfocal_protocol::autofocus::{
    FocusSample, FrameFault, Mode, SampleWanted, ScanId, ScanParameters, ScanReport, ScanState, SweepSample,
};
use parfocal_protocol::message::{Event, Refusal, Request, Response};
use parfocal_protocol::units::{BoardTime, FocusValue, HostTime, Micrometres, MicrometresPerSecond};
use thiserror::Error;

/// One sample of a focus curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Where; in a sweep by the board's record of steps, in the middle of the exposure.
    pub z: Micrometres,
    /// The value.
    pub phi: FocusValue,
}

/// What a scan is told about while it runs.
#[derive(Clone, Copy, Debug)]
pub enum Progress {
    /// A sample was measured and sent.
    Sample(Sample),
    /// A picture gave no value.
    Fault(FrameFault),
    /// Before a sweep: the pace of a camera that tells no exposure times is being learnt.
    Pacing {
        /// Frames seen.
        frames: usize,
        /// How well exposures are known by now, µs.
        doubt_us: f64,
    },
}

/// A scan that ended, focused or refused.
#[derive(Clone, Debug)]
pub struct Scanned {
    /// The board's report.
    pub report: ScanReport,
    /// Every sample in the order taken.
    pub samples: Vec<Sample>,
}

/// Why a scan could not be carried through.
#[derive(Debug, Error)]
pub enum ScanError {
    /// The board or the way to it.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The camera or its pictures. The board has been told to end the scan.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// Somebody else began another scan, or the board forgot this one.
    #[error("the board's scan is no longer this program's: look where the axis is, and begin anew")]
    Lost,
}

/// Two-way clock exchanges before a scan.
const EXCHANGES: usize = 8;

/// Between clock exchanges during a sweep, ms: crystals drift apart.
const EXCHANGE_MS: u64 = 100;

/// How long to wait for an event before asking the board where the scan stands: events may be lost.
const ASK_MS: u64 = 250;

/// The same for a scan that sweeps: that a leg has begun is no event, and its frames are wanted at once.
const ASK_SWEEPING_MS: u64 = 10;

/// Compares clocks with the board.
///
/// # Errors
/// As [`Link::request`].
pub fn compare_clocks(link: &mut Link, clock: &mut ClockModel, times: usize) -> Result<(), LinkError> {
    for _ in 0..times {
        let sent = link.now();
        if let Response::Clock { sent, received, answered } = link.request(Request::Clock { sent })? {
            clock.add(Exchange { sent, received, answered, returned: link.now() });
        }
    }
    Ok(())
}

/// Runs one scan to its end. `keep_on` is asked between samples; false ends the scan, which then returns to its start.
///
/// # Errors
/// [`ScanError`]. A refused scan is not an error: the report says why.
pub fn run(
    link: &mut Link,
    parameters: &ScanParameters,
    source: &mut dyn FocusSource,
    progress: &mut dyn FnMut(Progress),
    keep_on: &dyn Fn() -> bool,
) -> Result<Scanned, ScanError> {
    let frames = match parameters.mode {
        Mode::Step => Frames::Replayed { period_us: 0.0 },
        Mode::Sweep => source.ready(link.now(), speed(parameters), progress, keep_on)?,
    };
    let mut clock = ClockModel::default();
    compare_clocks(link, &mut clock, EXCHANGES)?;
    let compared = link.now();
    let mut run = Run {
        link,
        parameters,
        source,
        progress,
        frames,
        clock,
        compared,
        samples: Vec::new(),
        next: 0,
        due: compared,
    };
    let mut aborted = false;
    let mut state = scan_state(run.link.request(Request::AutofocusStart(*parameters))?);
    loop {
        if let ScanState::Ended(report) = state
            && report.scan == parameters.scan
        {
            return Ok(Scanned { report, samples: run.samples });
        }
        if !aborted && !keep_on() {
            aborted = true;
            state = run.abort()?;
            continue;
        }
        state = match state {
            ScanState::Waiting(wanted) if wanted.scan == parameters.scan && wanted.index >= run.next => {
                run.answer(&wanted)?
            }
            ScanState::Sweeping(scan) if scan == parameters.scan => run.stream()?,
            _ => run.wait()?,
        }
    }
}

/// The speed of a sweep, unless it is the axis' own.
fn speed(parameters: &ScanParameters) -> Option<MicrometresPerSecond> {
    (parameters.speed.0 > 0.0).then_some(parameters.speed)
}

struct Run<'a> {
    link: &'a mut Link,
    parameters: &'a ScanParameters,
    source: &'a mut dyn FocusSource,
    progress: &'a mut dyn FnMut(Progress),
    frames: Frames,
    clock: ClockModel,
    /// When the clocks were compared last.
    compared: HostTime,
    samples: Vec<Sample>,
    /// Number of the next sample.
    next: u32,
    /// When a recording shows its next frame.
    due: HostTime,
}

impl Run<'_> {
    /// Answers what the board, at rest, asks for.
    fn answer(&mut self, wanted: &SampleWanted) -> Result<ScanState, ScanError> {
        self.next = wanted.index + 1;
        let z = wanted.z.micrometres();
        // Compared at the start of the scan; without an answer any frame from now on is new enough.
        let since = self.clock.host_time(wanted.since).unwrap_or_else(|_| self.link.now());
        let value = self.value(z, since)?;
        self.record(z, value);
        let sample = FocusSample { scan: wanted.scan, index: wanted.index, value };
        Ok(match self.link.request(Request::AutofocusSample(sample)) {
            // Too late by a hair: the board gave up on this sample. Its state says what now.
            Err(LinkError::Refused(_)) => self.ask()?,
            other => scan_state(other?),
        })
    }

    /// Sends the next frame of a sweep.
    fn stream(&mut self) -> Result<ScanState, ScanError> {
        if self.link.now() >= later(self.compared, EXCHANGE_MS) {
            compare_clocks(self.link, &mut self.clock, 1)?;
            self.compared = self.link.now();
        }
        let Some((at, value)) = self.frame()? else { return self.ask() };
        let sample = SweepSample { scan: self.parameters.scan, index: self.next, at, value };
        self.next += 1;
        match self.link.request(Request::AutofocusSweepSample(sample)) {
            Ok(Response::Swept { z, state }) => {
                self.record(z.micrometres(), value);
                Ok(state)
            }
            Ok(other) => Ok(scan_state(other)),
            // From before the leg, or after it: such frames are part of the way.
            Err(LinkError::Refused(Refusal::WrongSample { wanted })) => {
                self.next = self.next.max(wanted);
                self.ask()
            }
            Err(LinkError::Refused(Refusal::WrongTime { .. })) => Ok(ScanState::Sweeping(self.parameters.scan)),
            Err(LinkError::Refused(_)) => self.ask(),
            Err(error) => Err(error.into()),
        }
    }

    /// The next frame's time and value; `None` when none came.
    fn frame(&mut self) -> Result<Option<(BoardTime, Judged)>, ScanError> {
        if let Frames::Replayed { period_us } = self.frames {
            while self.link.now() < self.due {
                self.link.event(self.due)?;
            }
            self.due = HostTime(self.due.0.max(self.link.now().0.saturating_sub(100_000)) + period_us as u64);
            let status = status(self.link)?;
            let axis = self.parameters.axis.index().unwrap_or(0);
            let (z, now) = (status.axes[axis].position.micrometres(), self.link.now());
            return Ok(Some((status.time, self.value(z, now)?)));
        }
        let next = self.source.next(later(self.link.now(), ASK_MS));
        let Some(dated) = self.or_abort(next)? else { return Ok(None) };
        Ok(self.clock.board_time(dated.middle).ok().map(|at| (at, dated.value)))
    }

    fn value(&mut self, z: Micrometres, since: HostTime) -> Result<Judged, ScanError> {
        let patience = u64::from(self.parameters.sample_timeout.0) * 1000 / 2;
        let deadline = HostTime(self.link.now().0.saturating_add(patience));
        let value = self.source.value(Wanted { z, since, deadline });
        self.or_abort(value)
    }

    /// A source that failed ends the scan.
    fn or_abort<T>(&mut self, result: Result<T, SourceError>) -> Result<T, ScanError> {
        match result {
            Ok(value) => Ok(value),
            Err(error) => {
                self.abort()?;
                Err(error.into())
            }
        }
    }

    fn record(&mut self, z: Micrometres, value: Judged) {
        match value {
            Ok(phi) => {
                let sample = Sample { z, phi };
                self.samples.push(sample);
                (self.progress)(Progress::Sample(sample));
            }
            Err(fault) => (self.progress)(Progress::Fault(fault)),
        }
    }

    /// Waits for what the board says next, and asks when that is nothing about this scan: positions told of a motion are not.
    fn wait(&mut self) -> Result<ScanState, ScanError> {
        let mine = self.parameters.scan;
        let patience = if self.parameters.mode == Mode::Sweep { ASK_SWEEPING_MS } else { ASK_MS };
        let deadline = later(self.link.now(), patience);
        loop {
            match self.link.event(deadline)? {
                Some(Event::SampleWanted(wanted)) if wanted.scan == mine => return Ok(ScanState::Waiting(wanted)),
                Some(Event::ScanEnded(report)) if report.scan == mine => return Ok(ScanState::Ended(report)),
                Some(_) => {}
                None => return self.ask(),
            }
        }
    }

    /// Where the scan stands, by the board.
    fn ask(&mut self) -> Result<ScanState, ScanError> {
        let state = scan_state(self.link.request(Request::AutofocusState)?);
        let scan = match state {
            ScanState::None => None,
            ScanState::Moving(scan) | ScanState::Sweeping(scan) => Some(scan),
            ScanState::Waiting(wanted) => Some(wanted.scan),
            ScanState::Ended(report) => Some(report.scan),
        };
        if scan == Some(self.parameters.scan) { Ok(state) } else { Err(ScanError::Lost) }
    }

    fn abort(&mut self) -> Result<ScanState, ScanError> {
        let scan: ScanId = self.parameters.scan;
        match self.link.request(Request::AutofocusAbort { scan }) {
            // Over already: its state is its report.
            Err(LinkError::Refused(_)) => self.ask(),
            other => Ok(scan_state(other?)),
        }
    }
}

fn scan_state(response: Response) -> ScanState {
    match response {
        Response::Scan(state) => state,
        _ => ScanState::None,
    }
}
