//! Runs a scan on an axis: turns what the scan asks for into motions and sample requests, and keeps time.

use crate::autofocus::{Ask, Scan};
use crate::motion::{Ending, Motion};
use crate::ports::Board;
use parfocal_protocol::autofocus::{
    FocusSample, Outcome, SampleWanted, ScanId, ScanParameters, ScanRefusal, ScanReport, ScanState, SweepSample,
};
use parfocal_protocol::message::{Event, Field, Refusal, StopCause};
use parfocal_protocol::units::{AXES, BoardTime, Micrometres, Milliseconds, Nanometres, PerAxis};

/// A wanted sample is told again after this long, until it is answered: events may be lost.
const REPEAT_US: u64 = 100_000;

/// What the axis is doing for the scan.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Doing {
    /// On its way to where a sample is wanted.
    Approaching,
    /// At rest, waiting for a sample since `asked`; told last at `told`.
    Waiting { wanted: SampleWanted, asked: BoardTime, told: Option<BoardTime> },
    /// On a leg of a sweep; the last sample came at `heard`.
    Sweeping { to: Nanometres, heard: BoardTime },
    /// Decelerating, to take up what was asked next.
    Turning { next: Ask },
    /// On its last way, without samples.
    Leaving,
}

#[derive(Clone, Debug)]
struct Running {
    parameters: ScanParameters,
    scan: Scan,
    doing: Doing,
    begun: BoardTime,
    /// Number of the next stepwise sample, or the least number that the next sweep sample may have.
    index: u32,
}

/// At most one scan at a time, and the report of the last one.
#[derive(Clone, Debug, Default)]
pub struct Focusing {
    running: Option<Running>,
    last: Option<ScanReport>,
    untold: bool,
    interrupted: bool,
}

impl Focusing {
    /// No scan yet.
    pub const fn new() -> Self {
        Self { running: None, last: None, untold: false, interrupted: false }
    }

    /// Whether a scan is under way.
    pub fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Where the latest scan stands.
    pub fn state(&self) -> ScanState {
        match (&self.running, self.last) {
            (Some(running), _) => match running.doing {
                Doing::Waiting { wanted, .. } => ScanState::Waiting(wanted),
                Doing::Sweeping { .. } => ScanState::Sweeping(running.parameters.scan),
                Doing::Approaching | Doing::Turning { .. } | Doing::Leaving => {
                    ScanState::Moving(running.parameters.scan)
                }
            },
            (None, Some(report)) => ScanState::Ended(report),
            (None, None) => ScanState::None,
        }
    }

    /// Begins a scan from where the axis is.
    ///
    /// # Errors
    /// [`Refusal::Busy`] while something moves or scans, [`Refusal::OutOfRange`] and [`Refusal::BeyondLimit`] for parameters
    /// that make no sense.
    pub fn start(
        &mut self,
        now: BoardTime,
        parameters: &ScanParameters,
        motion: &mut Motion,
        board: &mut impl Board,
    ) -> Result<ScanState, Refusal> {
        if motion.emergency_in_force() {
            return Err(Refusal::Emergency);
        }
        if self.is_running() || !motion.in_position() {
            return Err(Refusal::Busy);
        }
        let settings = *motion.settings(parameters.axis);
        if parameters.low < settings.low || parameters.high > settings.high {
            return Err(Refusal::BeyondLimit { axis: parameters.axis, low: settings.low, high: settings.high });
        }
        if !(parameters.speed.0 >= 0.0 && parameters.speed.0 <= settings.speed.0) {
            return Err(Refusal::OutOfRange { field: Field::Speed, low: 0.0, high: settings.speed.0 });
        }
        let here = motion.status(board, parameters.axis).position;
        let (scan, ask) = Scan::begin(parameters, here)?;
        let mut running = Running { parameters: *parameters, scan, doing: Doing::Approaching, begun: now, index: 0 };
        (self.interrupted, self.untold) = (false, false);
        running.obey(now, ask, motion, board);
        self.running = Some(running);
        Ok(self.state())
    }

    /// Takes the answer to a [`SampleWanted`].
    ///
    /// # Errors
    /// [`Refusal::NoSuchScan`], [`Refusal::WrongSample`] and [`Refusal::NotANumber`]; the scan goes on waiting.
    // A function of its own in the program, too: the emulator counts what it takes.
    #[inline(never)]
    pub fn sample(
        &mut self,
        now: BoardTime,
        sample: &FocusSample,
        motion: &mut Motion,
        board: &mut impl Board,
    ) -> Result<ScanState, Refusal> {
        let running = self.current(sample.scan)?;
        let wanted = running.index;
        let Doing::Waiting { wanted: SampleWanted { z, index, .. }, .. } = running.doing else {
            return Err(Refusal::WrongSample { wanted });
        };
        if sample.index != index {
            return Err(Refusal::WrongSample { wanted: index });
        }
        if sample.value.is_ok_and(|v| !v.0.is_finite()) {
            return Err(Refusal::NotANumber);
        }
        running.index += 1;
        let ask = running.scan.sample(z, sample.value);
        running.obey(now, ask, motion, board);
        self.finish(now, motion, board);
        Ok(self.state())
    }

    /// Takes a sample of a sweep: the axis' place at that time is looked up in the board's own record.
    ///
    /// # Errors
    /// As [`Focusing::sample`]; [`Refusal::OldSequence`] for a time that the record no longer, or not yet, covers.
    pub fn sweep_sample(
        &mut self,
        now: BoardTime,
        sample: &SweepSample,
        motion: &mut Motion,
        board: &mut impl Board,
    ) -> Result<ScanState, Refusal> {
        let running = self.current(sample.scan)?;
        let Doing::Sweeping { heard, .. } = &mut running.doing else {
            return Err(Refusal::WrongSample { wanted: running.index });
        };
        if sample.index < running.index {
            return Err(Refusal::WrongSample { wanted: running.index });
        }
        if sample.value.is_ok_and(|v| !v.0.is_finite()) {
            return Err(Refusal::NotANumber);
        }
        let z = motion.position_at(board, running.parameters.axis, sample.at).ok_or(Refusal::OldSequence)?;
        *heard = now;
        running.index = sample.index + 1;
        let ask = running.scan.sample(z, sample.value);
        running.obey(now, ask, motion, board);
        self.finish(now, motion, board);
        Ok(self.state())
    }

    /// Ends a scan on request; the axis returns to its start.
    ///
    /// # Errors
    /// [`Refusal::NoSuchScan`].
    pub fn abort(
        &mut self,
        now: BoardTime,
        scan: ScanId,
        motion: &mut Motion,
        board: &mut impl Board,
    ) -> Result<ScanState, Refusal> {
        let running = self.current(scan)?;
        let ask = running.scan.abort(ScanRefusal::Aborted);
        running.obey(now, ask, motion, board);
        self.finish(now, motion, board);
        Ok(self.state())
    }

    /// The axis was stopped for a reason of its own: the scan ends where it is.
    pub fn interrupted(&mut self) {
        self.interrupted = self.running.is_some();
    }

    /// A motion ended early. A sweep's leg that was cut short on purpose is no interruption.
    pub fn stopped(&mut self, cause: StopCause) {
        let turning = self.running.as_ref().is_some_and(|r| matches!(r.doing, Doing::Turning { .. }));
        if !(turning && cause == StopCause::Asked) {
            self.interrupted();
        }
    }

    /// What happens by itself: arrivals, samples told again, samples that stop coming.
    pub fn poll(&mut self, now: BoardTime, motion: &mut Motion, board: &mut impl Board) -> Option<Event> {
        if let Some(running) = self.running.as_mut() {
            if self.interrupted {
                if !motion.in_position() {
                    return None;
                }
                running.end(now, motion, board, Outcome::Refused(ScanRefusal::MotionStopped), &mut self.last);
                (self.running, self.interrupted, self.untold) = (None, false, true);
            } else {
                running.advance(now, motion, board);
                if let Doing::Waiting { wanted, told, .. } = &mut running.doing
                    && told.is_none_or(|told| now.since(told) >= REPEAT_US)
                {
                    *told = Some(now);
                    return Some(Event::SampleWanted(*wanted));
                }
                self.finish(now, motion, board);
            }
        }
        let report = self.last.filter(|_| core::mem::take(&mut self.untold))?;
        Some(Event::ScanEnded(report))
    }

    fn current(&mut self, scan: ScanId) -> Result<&mut Running, Refusal> {
        let last = self.last.map(|report| report.scan);
        match self.running.as_mut() {
            Some(running) if running.parameters.scan == scan && !self.interrupted => Ok(running),
            Some(running) => Err(Refusal::NoSuchScan { current: Some(running.parameters.scan) }),
            None => Err(Refusal::NoSuchScan { current: last }),
        }
    }

    /// Turns an ended scan into its report.
    fn finish(&mut self, now: BoardTime, motion: &Motion, board: &mut impl Board) {
        let Some(running) = self.running.as_mut() else { return };
        let Some(outcome) = running.scan.summary().outcome else { return };
        running.end(now, motion, board, outcome, &mut self.last);
        (self.running, self.untold) = (None, true);
    }
}

impl Running {
    /// Does what the scan asks.
    fn obey(&mut self, now: BoardTime, ask: Ask, motion: &mut Motion, board: &mut impl Board) {
        if ask == Ask::Wait {
            return;
        }
        if matches!(self.doing, Doing::Sweeping { .. }) && !motion.in_position() {
            if self.doing == (Doing::Sweeping { to: target(ask), heard: now }) {
                return;
            }
            // The end of the leg is where the axis comes to rest; `advance` tells the scan and takes up what it asks then.
            motion.stop(now, board, StopCause::Asked);
            self.doing = Doing::Turning { next: ask };
            return;
        }
        match ask {
            Ask::Wait | Ask::Ended(_) => {}
            Ask::Sample { z } => self.go(now, z, Ending::Direct, Doing::Approaching, motion, board),
            Ask::Sweep { to } => {
                self.go(now, to, Ending::Direct, Doing::Sweeping { to, heard: now }, motion, board);
            }
            Ask::Go { z } => self.go(now, z, Ending::Approach, Doing::Leaving, motion, board),
        }
    }

    fn go(
        &mut self,
        now: BoardTime,
        z: Nanometres,
        ending: Ending,
        doing: Doing,
        motion: &mut Motion,
        board: &mut impl Board,
    ) {
        let mut to: PerAxis<Option<Nanometres>> = [None; AXES];
        if let Some(axis) = self.parameters.axis.index() {
            to[axis] = Some(z);
        }
        let speed = (self.parameters.speed.0 > 0.0).then_some(self.parameters.speed);
        match motion.move_to(now, board, &to, speed, ending) {
            Ok(_) => self.doing = doing,
            Err(_) => {
                // A switch, say, that was pressed by hand: no further motion is wanted, so the scan ends here.
                self.scan.abort(ScanRefusal::MotionStopped);
                let here = motion.status(board, self.parameters.axis).position;
                self.scan.arrived(here);
                self.doing = Doing::Leaving;
            }
        }
    }

    /// Looks whether the axis has arrived, and whether samples still come.
    fn advance(&mut self, now: BoardTime, motion: &mut Motion, board: &mut impl Board) {
        let patience = u64::from(self.parameters.sample_timeout.0) * 1000;
        match self.doing {
            Doing::Waiting { asked, .. } if now.since(asked) > patience => {
                let ask = self.scan.abort(ScanRefusal::SamplesStopped);
                self.obey(now, ask, motion, board);
            }
            Doing::Waiting { .. } => {}
            Doing::Sweeping { heard, .. } if now.since(heard) > patience => {
                let ask = self.scan.abort(ScanRefusal::SamplesStopped);
                self.obey(now, ask, motion, board);
            }
            _ if !motion.in_position() => {}
            Doing::Approaching => {
                let z = self.here(motion, board);
                let wanted = SampleWanted { scan: self.parameters.scan, index: self.index, z, since: now };
                self.doing = Doing::Waiting { wanted, asked: now, told: None };
            }
            Doing::Leaving | Doing::Sweeping { .. } | Doing::Turning { .. } => {
                let z = self.here(motion, board);
                let ask = match self.doing {
                    Doing::Turning { next } if matches!(next, Ask::Go { .. }) => next,
                    _ => self.scan.arrived(z),
                };
                self.doing = Doing::Leaving;
                self.obey(now, ask, motion, board);
            }
        }
    }

    fn here(&self, motion: &Motion, board: &mut impl Board) -> Nanometres {
        motion.status(board, self.parameters.axis).position
    }

    fn end(
        &self,
        now: BoardTime,
        motion: &Motion,
        board: &mut impl Board,
        outcome: Outcome,
        last: &mut Option<ScanReport>,
    ) {
        let summary = self.scan.summary();
        *last = Some(ScanReport {
            scan: self.parameters.scan,
            outcome,
            start: summary.start,
            best: summary.best,
            end: self.here(motion, board),
            travel: summary.travel,
            approach: Micrometres(f64::from(motion.approach_um())).nanometres().unwrap_or_default(),
            frames: summary.frames,
            duration: Milliseconds((now.since(self.begun) / 1000) as u32),
        });
    }
}

fn target(ask: Ask) -> Nanometres {
    match ask {
        Ask::Sample { z } | Ask::Go { z } => z,
        Ask::Sweep { to } => to,
        Ask::Wait | Ask::Ended(_) => Nanometres(0),
    }
}
