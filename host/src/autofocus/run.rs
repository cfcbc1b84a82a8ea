//! The loop of a stepwise scan: start it, answer what the board asks for, until it ends.

use super::source::{FocusSource, SourceError, Wanted};
use crate::clock::{ClockModel, Exchange};
use crate::link::transport::later;
use crate::link::{Link, LinkError};
use parfocal_protocol::autofocus::{
    FocusSample, FrameFault, SampleWanted, ScanId, ScanParameters, ScanReport, ScanState,
};
use parfocal_protocol::message::{Event, Request, Response};
use parfocal_protocol::units::{FocusValue, HostTime, Micrometres};
use thiserror::Error;

/// One sample of a focus curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Where.
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
pub enum AutofocusError {
    /// The board or the way to it.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The camera or its pictures. The board has been told to end the scan.
    #[error(transparent)]
    Source(#[from] SourceError),
}

/// Two-way clock exchanges before a scan.
const EXCHANGES: usize = 8;

/// How long to wait for an event before asking the board where the scan stands: events may be lost.
const ASK_MS: u64 = 250;

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
/// [`AutofocusError`]. A refused scan is not an error: the report says why.
pub fn run(
    link: &mut Link,
    parameters: &ScanParameters,
    source: &mut dyn FocusSource,
    progress: &mut dyn FnMut(Progress),
    keep_on: &dyn Fn() -> bool,
) -> Result<Scanned, AutofocusError> {
    let mut clock = ClockModel::default();
    compare_clocks(link, &mut clock, EXCHANGES)?;
    let mut samples = Vec::new();
    let mut answered: Option<u32> = None;
    let mut state = scan_state(link.request(Request::AutofocusStart(*parameters))?);
    loop {
        match state {
            ScanState::Ended(report) if report.scan == parameters.scan => return Ok(Scanned { report, samples }),
            ScanState::Waiting(wanted) if wanted.scan == parameters.scan && answered != Some(wanted.index) => {
                if !keep_on() {
                    state = abort(link, parameters.scan)?;
                    continue;
                }
                answered = Some(wanted.index);
                let value = match source.value(when(link, &clock, &wanted, parameters)) {
                    Ok(value) => value,
                    Err(error) => {
                        abort(link, parameters.scan)?;
                        return Err(error.into());
                    }
                };
                match value {
                    Ok(phi) => {
                        let sample = Sample { z: wanted.z.micrometres(), phi };
                        samples.push(sample);
                        progress(Progress::Sample(sample));
                    }
                    Err(fault) => progress(Progress::Fault(fault)),
                }
                let sample = FocusSample { scan: wanted.scan, index: wanted.index, value };
                state = match link.request(Request::AutofocusSample(sample)) {
                    // Too late by a hair: the board gave up on this sample. Its state says what now.
                    Err(LinkError::Refused(_)) => scan_state(link.request(Request::AutofocusState)?),
                    other => scan_state(other?),
                };
            }
            _ => {
                state = match link.event(later(link.now(), ASK_MS))? {
                    Some(Event::SampleWanted(wanted)) => ScanState::Waiting(wanted),
                    Some(Event::ScanEnded(report)) => ScanState::Ended(report),
                    Some(_) => state,
                    None => scan_state(link.request(Request::AutofocusState)?),
                };
                if !keep_on() && matches!(state, ScanState::Moving(_)) {
                    state = abort(link, parameters.scan)?;
                }
            }
        }
    }
}

fn abort(link: &mut Link, scan: ScanId) -> Result<ScanState, LinkError> {
    match link.request(Request::AutofocusAbort { scan }) {
        // Over already: its state is its report.
        Err(LinkError::Refused(_)) => Ok(scan_state(link.request(Request::AutofocusState)?)),
        other => Ok(scan_state(other?)),
    }
}

fn scan_state(response: Response) -> ScanState {
    match response {
        Response::Scan(state) => state,
        _ => ScanState::None,
    }
}

fn when(link: &Link, clock: &ClockModel, wanted: &SampleWanted, parameters: &ScanParameters) -> Wanted {
    // Compared at the start of the scan; without an answer any frame from now on is new enough.
    let since = clock.host_time(wanted.since).unwrap_or_else(|_| link.now());
    let patience = u64::from(parameters.sample_timeout.0) * 1000 / 2;
    let deadline = HostTime(link.now().0.saturating_add(patience));
    Wanted { z: wanted.z.micrometres(), since, deadline }
}
