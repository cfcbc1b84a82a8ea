//! A scan from its first frame to its end: faults, legs of a sweep, the judgement, the last move, the last look.

use super::curve::{Curve, Side, magnitude};
use super::judge::Judging;
use super::noise::root;
use super::parameters::check;
use super::peak::Peak;
use super::search::{Lengths, Named, Next, Search};
use super::work::Slice;
use core::task::Poll;
use parfocal_protocol::autofocus::{FrameFault, Mode, Outcome, ScanParameters, ScanRefusal, Subject};
use parfocal_protocol::message::Refusal;
use parfocal_protocol::units::{FocusValue, Nanometres};

/// What a scan wants next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ask {
    /// Stop at `z`, settle, and tell a value from there ([`Scan::sample`]). The same `z` again means one more frame. A
    /// sweep, too, begins and ends with frames at rest.
    Sample {
        /// Where.
        z: Nanometres,
    },
    /// Move at constant speed to `to`, replacing the leg that runs, if any; tell the values of frames exposed during
    /// the leg as they come, then [`Scan::arrived`].
    Sweep {
        /// End of the leg.
        to: Nanometres,
    },
    /// Move to `z` without samples, ending a sweep; then tell [`Scan::arrived`].
    Go {
        /// Where.
        z: Nanometres,
    },
    /// There is more to work out than is done at once: call [`Scan::think`] until the answer is another one. No frames are
    /// wanted meanwhile; those of a sweep that come all the same may be told.
    Think,
    /// Nothing new: go on with what was asked last.
    Wait,
    /// The scan is over.
    Ended(Outcome),
}

/// What a scan found out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// How it ended; `None` while it runs.
    pub outcome: Option<Outcome>,
    /// Where it began.
    pub start: Nanometres,
    /// The peak by the fit; for a refusal the best sample seen.
    pub best: Nanometres,
    /// J: the way between all positions told so far.
    pub travel: Nanometres,
    /// Frames used.
    pub frames: u32,
}

/// Frames without a value in a row, before the scan gives up.
const FAULTS: u8 = 3;

/// Frames of the last look, if there is noise.
const LOOKS: u32 = 4;

/// The last look may fall short of the peak's height above the floor by this share.
const SHORT: f64 = 0.15;

/// Standard errors that the last look may fall short by.
const DOUBT: f64 = 5.0;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// The search asks for frames.
    Searching,
    /// The search is over, and its curve is judged.
    Judging,
    /// On the way to the result, which is not told before it is reached.
    Leaving(Outcome),
    /// The last look.
    Verifying { sum: f64, frames: u32 },
    /// Over.
    Ended(Outcome),
}

/// What is worked out.
#[derive(Clone, Debug)]
enum Task {
    Search(Named),
    Judge(Judging),
}

/// A running scan.
#[derive(Clone, Debug)]
pub struct Scan {
    curve: Curve,
    task: Task,
    /// Whether [`Scan::think`] is waited for.
    thinking: bool,
    mode: Mode,
    subject: Subject,
    verify: bool,
    /// Whether the last look fell short of the best sample, and the way went there.
    again: bool,
    trap: i32,
    start: Nanometres,
    here: Nanometres,
    asked: Ask,
    found: Option<Peak>,
    travel: i32,
    looks: u32,
    faults: u8,
    stage: Stage,
}

impl Scan {
    /// Checks the parameters and says what the scan wants first. `z0` is where the axis is.
    ///
    /// # Errors
    /// [`Refusal::OutOfRange`] names the first field that makes no sense.
    pub fn begin(parameters: &ScanParameters, z0: Nanometres) -> Result<(Self, Ask), Refusal> {
        check(parameters, z0)?;
        let curve = Curve::new(z0, parameters.low, parameters.high, parameters.sample_step);
        let lengths = Lengths::new(parameters, &curve);
        let asked = Ask::Sample { z: z0 };
        let scan = Self {
            curve,
            task: Task::Search(Named::new(parameters.strategy, lengths)),
            thinking: false,
            mode: parameters.mode,
            subject: parameters.subject,
            verify: parameters.verify,
            again: false,
            trap: lengths.trap,
            start: z0,
            here: z0,
            asked,
            found: None,
            travel: 0,
            looks: 0,
            faults: 0,
            stage: Stage::Searching,
        };
        Ok((scan, asked))
    }

    /// Takes in a value, or why there is none, from `z`; in a sweep in the order of exposure.
    pub fn sample(&mut self, z: Nanometres, value: Result<FocusValue, FrameFault>) -> Ask {
        let before = self.think_to_the_end();
        if !matches!(self.stage, Stage::Searching | Stage::Verifying { .. }) {
            return before;
        }
        let ask = self.take(z, value);
        if ask == Ask::Wait { before } else { ask }
    }

    fn take(&mut self, z: Nanometres, value: Result<FocusValue, FrameFault>) -> Ask {
        self.reach(z);
        let value = match value {
            Ok(value) if value.0.is_finite() => value,
            fault => return self.fault(fault.err()),
        };
        self.faults = 0;
        if let Stage::Verifying { sum, frames } = self.stage {
            self.looks += 1;
            return self.compare(sum + value.0, frames + 1);
        }
        let at_rest = matches!(self.asked, Ask::Sample { .. }) && z == self.start && self.curve.travelled() == 0;
        if at_rest {
            self.curve.add_at_rest(z, value);
        } else {
            self.curve.add(z, value);
        }
        if !self.curve.noise().is_silent() || self.curve.settle(&mut Slice::none()).is_pending() {
            // Taking the frame in was work enough.
            self.thinking = true;
            return Ask::Think;
        }
        self.search_on()
    }

    /// A move without a sample, or a leg of a sweep, is over: the axis rests at `z`.
    pub fn arrived(&mut self, z: Nanometres) -> Ask {
        self.think_to_the_end();
        self.reach(z);
        match (self.stage, self.asked) {
            (Stage::Leaving(Outcome::Focused), _) if self.verify => {
                self.stage = Stage::Verifying { sum: 0.0, frames: 0 };
                self.ask(Ask::Sample { z })
            }
            (Stage::Leaving(outcome), _) => self.end(outcome),
            (Stage::Searching, Ask::Sweep { .. }) => {
                self.curve.visit(z);
                self.asked = Ask::Wait;
                self.search_on()
            }
            (Stage::Judging, _) => Ask::Think,
            _ => self.asked,
        }
    }

    /// Goes on with what is being worked out, for a slice of time. What comes of it does not depend on when this is called.
    // A function of its own in the program, too: the emulator counts what it takes.
    #[inline(never)]
    pub fn think(&mut self) -> Ask {
        match self.stage {
            Stage::Searching if self.thinking => self.search_on(),
            Stage::Judging => self.judge_on(),
            _ => self.asked,
        }
    }

    /// Whether [`Scan::think`] is waited for.
    pub fn is_thinking(&self) -> bool {
        self.thinking
    }

    /// Whether frames are still wanted.
    pub fn is_searching(&self) -> bool {
        self.stage == Stage::Searching
    }

    /// A frame of a sweep came before the search knew what to make of those before it.
    fn think_to_the_end(&mut self) -> Ask {
        let mut ask = Ask::Wait;
        while self.thinking && self.stage == Stage::Searching {
            ask = self.search_on();
        }
        ask
    }

    /// Ends the scan for a reason from outside, and returns to its start.
    pub fn abort(&mut self, why: ScanRefusal) -> Ask {
        match self.stage {
            Stage::Searching | Stage::Judging | Stage::Verifying { .. } | Stage::Leaving(Outcome::Focused) => {
                self.thinking = false;
                self.stage = Stage::Leaving(Outcome::Refused(why));
                self.ask(Ask::Go { z: self.start })
            }
            Stage::Leaving(_) | Stage::Ended(_) => self.asked,
        }
    }

    /// Ends the scan where it is: the axis cannot or must not move any more.
    pub fn cut(&mut self, why: ScanRefusal) -> Ask {
        match self.stage {
            Stage::Ended(_) => self.asked,
            _ => self.end(Outcome::Refused(why)),
        }
    }

    /// What was asked last, for a controller that has to say it again.
    pub fn asked(&self) -> Ask {
        self.asked
    }

    /// What is known of it by now.
    pub fn summary(&self) -> Summary {
        let refused = matches!(self.stage, Stage::Leaving(Outcome::Refused(_)) | Stage::Ended(Outcome::Refused(_)));
        let best = match self.found {
            Some(peak) if !refused => self.curve.exactly(peak.at),
            _ => self.curve.best().map_or(self.start, |(place, _)| self.curve.position(place)),
        };
        Summary {
            outcome: if let Stage::Ended(outcome) = self.stage { Some(outcome) } else { None },
            start: self.start,
            best,
            travel: Nanometres(self.travel),
            frames: self.curve.frames() + self.looks,
        }
    }

    fn ask(&mut self, ask: Ask) -> Ask {
        self.asked = ask;
        ask
    }

    fn end(&mut self, outcome: Outcome) -> Ask {
        self.thinking = false;
        self.stage = Stage::Ended(outcome);
        self.ask(Ask::Ended(outcome))
    }

    fn reach(&mut self, z: Nanometres) {
        self.travel = self.travel.saturating_add(z.0.saturating_sub(self.here.0).saturating_abs());
        self.here = z;
    }

    fn fault(&mut self, fault: Option<FrameFault>) -> Ask {
        self.faults += 1;
        if self.faults < FAULTS {
            // Stepwise the same frame is wanted again; a sweep goes on.
            return if let Ask::Sample { .. } = self.asked { self.asked } else { Ask::Wait };
        }
        self.abort(match fault {
            Some(FrameFault::Blank) => ScanRefusal::NoContrast,
            Some(FrameFault::Saturated) => ScanRefusal::Saturated,
            Some(FrameFault::Stale) => ScanRefusal::StaleFrames,
            Some(FrameFault::NoFrame) | None => ScanRefusal::SamplesStopped,
        })
    }

    fn search_on(&mut self) -> Ask {
        if self.curve.frames() == 0 {
            // A sweep without a single frame.
            return self.abort(ScanRefusal::SamplesStopped);
        }
        let mut slice = Slice::new();
        if self.curve.settle(&mut slice).is_pending() || slice.is_begun() {
            self.thinking = true;
            return Ask::Think;
        }
        let Task::Search(search) = &mut self.task else { return self.asked };
        let next = search.next(&self.curve);
        self.thinking = !matches!(next, Next::Sample(_));
        let place = match next {
            Next::Sample(place) => place,
            Next::Thinking => return Ask::Think,
            Next::Enough => {
                self.task = Task::Judge(Judging::new(self.trap, self.subject, self.mode == Mode::Sweep));
                self.stage = Stage::Judging;
                return Ask::Think;
            }
        };
        let here = self.curve.here();
        if self.mode == Mode::Step || place == here {
            return self.ask(Ask::Sample { z: self.curve.position(place) });
        }
        let side = if place > here { Side::High } else { Side::Low };
        let leg = Ask::Sweep { to: self.curve.position(self.curve.limit(side)) };
        if self.asked == leg { Ask::Wait } else { self.ask(leg) }
    }

    fn judge_on(&mut self) -> Ask {
        let Task::Judge(judging) = &mut self.task else { return self.asked };
        match judging.step(&self.curve, &mut Slice::new()) {
            Poll::Pending => Ask::Think,
            Poll::Ready(Ok(peak)) => {
                self.thinking = false;
                self.found = Some(peak);
                self.stage = Stage::Leaving(Outcome::Focused);
                self.ask(Ask::Go { z: self.curve.exactly(peak.at) })
            }
            Poll::Ready(Err(why)) => self.abort(why),
        }
    }

    /// Never ends blurrier than the best seen, nor than the start.
    fn compare(&mut self, sum: f64, frames: u32) -> Ask {
        let noise = self.curve.noise();
        if frames < if noise.is_silent() { 1 } else { LOOKS } {
            self.stage = Stage::Verifying { sum, frames };
            return self.asked;
        }
        let mean = sum / f64::from(frames);
        let Some(peak) = self.found else { return self.asked };
        let error = noise.relative() * magnitude(peak.value) / root(f64::from(frames));
        if self.subject == Subject::PhaseObject {
            // In focus its contrast is lowest.
            let lobe = self.curve.best().map_or(peak.value, |(_, v)| v);
            let highest = peak.value + SHORT * (lobe - peak.value) + DOUBT * error;
            return if mean > highest { self.abort(ScanRefusal::NotReproduced) } else { self.end(Outcome::Focused) };
        }
        let lowest = peak.value - SHORT * magnitude(peak.value - self.curve.floor()) - DOUBT * error;
        if mean < lowest {
            return self.abort(ScanRefusal::NotReproduced);
        }
        // The fit may miss a pointed top: then the best sample is better than the fit, and is looked at in turn.
        if let Some((place, value)) = self.curve.best()
            && !self.again
            && mean < value - DOUBT * error
        {
            self.again = true;
            self.found = Some(Peak { at: f64::from(place.0), value, ..peak });
            self.stage = Stage::Leaving(Outcome::Focused);
            return self.ask(Ask::Go { z: self.curve.position(place) });
        }
        // The start was one frame.
        if mean < self.curve.reference() - DOUBT * error * root(f64::from(frames + 1)) {
            return self.abort(ScanRefusal::NotReproduced);
        }
        self.end(Outcome::Focused)
    }
}
