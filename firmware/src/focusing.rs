//! Runs a scan on an axis: turns what the scan asks for into motions and sample requests, and keeps time.

use crate::autofocus::{Ask, Scan};
use crate::motion::{Ending, Motion};
use crate::ports::Board;
use parfocal_protocol::autofocus::{
    FocusSample, Mode, Outcome, SampleWanted, ScanId, ScanParameters, ScanRefusal, ScanReport, ScanState, SweepSample,
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
    /// On a leg of a sweep, or at its end until the last of its frames have come.
    Sweeping(Leg),
    /// Decelerating, to take up what was asked next.
    Ending { next: Ask },
    /// At rest, while the scan works out what is next.
    Thinking,
    /// On its last way, without samples.
    Leaving,
}

/// One leg of a sweep. Frames come late, so it is over only with the first one that was exposed after its end.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Leg {
    to: Nanometres,
    /// Exposure of the latest frame told; no later one may be earlier. At first: when the leg began.
    told: BoardTime,
    /// When the latest sample came.
    heard: BoardTime,
    /// Whether it was cut short to go the other way.
    turning: bool,
    /// Since when the axis rests at its end.
    ended: Option<BoardTime>,
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
                Doing::Sweeping(_) => ScanState::Sweeping(running.parameters.scan),
                Doing::Approaching | Doing::Ending { .. } | Doing::Thinking | Doing::Leaving => {
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

    /// Takes a sample of a sweep: where the axis was at that time is looked up in the board's own record, and told.
    ///
    /// # Errors
    /// As [`Focusing::sample`]; [`Refusal::WrongTime`] for a frame exposed before the leg began, before the one told last, or
    /// later than now. The sweep goes on.
    pub fn sweep_sample(
        &mut self,
        now: BoardTime,
        sample: &SweepSample,
        motion: &mut Motion,
        board: &mut impl Board,
    ) -> Result<(Nanometres, ScanState), Refusal> {
        let running = self.current(sample.scan)?;
        let Doing::Sweeping(leg) = &mut running.doing else {
            return Err(Refusal::WrongSample { wanted: running.index });
        };
        if sample.index < running.index {
            return Err(Refusal::WrongSample { wanted: running.index });
        }
        if sample.value.is_ok_and(|v| !v.0.is_finite()) {
            return Err(Refusal::NotANumber);
        }
        let wrong = Refusal::WrongTime { earliest: leg.told, latest: now };
        if sample.at < leg.told || sample.at > now {
            return Err(wrong);
        }
        let z = motion.position_at(board, running.parameters.axis, sample.at).ok_or(wrong)?;
        (leg.told, leg.heard) = (sample.at, now);
        let over = leg.ended.is_some_and(|ended| sample.at >= ended);
        running.index = sample.index + 1;
        let ask = if over { running.scan.arrived(z) } else { running.scan.sample(z, sample.value) };
        if over {
            running.doing = Doing::Leaving;
        }
        running.obey(now, ask, motion, board);
        self.finish(now, motion, board);
        Ok((z, self.state()))
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
        let turning = self.running.as_ref().is_some_and(|r| match r.doing {
            Doing::Sweeping(leg) => leg.turning,
            Doing::Ending { .. } => true,
            _ => false,
        });
        if !(turning && cause == StopCause::Asked) {
            self.interrupted();
        }
    }

    /// Whether there is something to work out: [`Focusing::poll`] is wanted at once.
    pub fn is_thinking(&self) -> bool {
        !self.interrupted && self.running.as_ref().is_some_and(|running| running.scan.is_thinking())
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
        if ask == Ask::Wait || (ask == Ask::Think && self.scan.is_searching() && self.sweeps()) {
            // A sweep goes on while the search thinks.
            return;
        }
        if let Doing::Sweeping(leg) = &mut self.doing {
            let on = matches!(ask, Ask::Sweep { to } if to == leg.to && !leg.turning);
            // Turned or at its end already: when the last frames have come, the scan is asked again.
            if on || (matches!(ask, Ask::Sweep { .. }) && (leg.turning || leg.ended.is_some())) {
                return;
            }
            if !motion.in_position() {
                motion.stop(now, board, StopCause::Asked);
                if matches!(ask, Ask::Sweep { .. }) {
                    leg.turning = true;
                } else {
                    self.doing = Doing::Ending { next: ask };
                }
                return;
            }
        }
        match ask {
            Ask::Wait | Ask::Ended(_) => {}
            Ask::Think => self.doing = Doing::Thinking,
            Ask::Sample { z } => self.go(now, z, Ending::Direct, Doing::Approaching, motion, board),
            Ask::Sweep { to } => {
                let leg = Leg { to, told: now, heard: now, turning: false, ended: None };
                self.go(now, to, Ending::Direct, Doing::Sweeping(leg), motion, board);
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
        // A sweep's speed is for the camera's sake; on the way out and back nobody looks.
        let own = self.parameters.mode == Mode::Sweep && !matches!(doing, Doing::Sweeping(_));
        let speed = (self.parameters.speed.0 > 0.0 && !own).then_some(self.parameters.speed);
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
        if self.scan.is_thinking() {
            let ask = self.scan.think();
            match &mut self.doing {
                Doing::Ending { next } => *next = ask,
                _ => self.obey(now, ask, motion, board),
            }
            return;
        }
        let patience = u64::from(self.parameters.sample_timeout.0) * 1000;
        match self.doing {
            Doing::Waiting { asked, .. } if now.since(asked) > patience => {
                let ask = self.scan.abort(ScanRefusal::SamplesStopped);
                self.obey(now, ask, motion, board);
            }
            Doing::Waiting { .. } | Doing::Thinking => {}
            Doing::Sweeping(leg) if now.since(leg.heard) > patience => {
                let ask = self.scan.abort(ScanRefusal::SamplesStopped);
                self.obey(now, ask, motion, board);
            }
            _ if !motion.in_position() => {}
            Doing::Sweeping(leg) => {
                self.doing = Doing::Sweeping(Leg { ended: leg.ended.or(Some(now)), ..leg });
            }
            Doing::Approaching => {
                let z = self.here(motion, board);
                let wanted = SampleWanted { scan: self.parameters.scan, index: self.index, z, since: now };
                self.doing = Doing::Waiting { wanted, asked: now, told: None };
            }
            Doing::Leaving => {
                let z = self.here(motion, board);
                let ask = self.scan.arrived(z);
                self.obey(now, ask, motion, board);
            }
            Doing::Ending { next } => {
                self.doing = Doing::Leaving;
                self.obey(now, next, motion, board);
            }
        }
    }

    fn sweeps(&self) -> bool {
        matches!(self.doing, Doing::Sweeping(_))
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
