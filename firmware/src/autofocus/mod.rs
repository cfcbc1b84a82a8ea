//! Scans for focus: the board decides every move, the host turns frames into values.
//!
//! A [`Scan`] is sans-IO: it is told values and arrivals, and each answer says what it wants next as an [`Ask`].
//!
//! ```
//! use parfocal_firmware::autofocus::{Ask, Scan};
//! use parfocal_protocol::autofocus::{Mode, Outcome, ScanId, ScanParameters, Strategy, Subject};
//! use parfocal_protocol::units::{Axis, FocusValue, MicrometresPerSecond, Milliseconds, Nanometres};
//!
//! let parameters = ScanParameters {
//!     scan: ScanId(1),
//!     axis: Axis(2),
//!     strategy: Strategy::Climb,
//!     mode: Mode::Step,
//!     subject: Subject::Peak,
//!     low: Nanometres(-100_000),
//!     high: Nanometres(100_000),
//!     sample_step: Nanometres(500),
//!     trap: Nanometres(10_000),
//!     probe: Nanometres(5_000),
//!     speed: MicrometresPerSecond(0.0),
//!     sample_timeout: Milliseconds(1_000),
//!     verify: false,
//! };
//! let phi = |z: Nanometres| FocusValue(1.0 / (1.0 + (f64::from(z.0) / 10_000.0 - 3.0).powi(2)));
//! let (mut scan, mut ask) = Scan::begin(&parameters, Nanometres(0)).unwrap();
//! let outcome = loop {
//!     ask = match ask {
//!         Ask::Sample { z } => scan.sample(z, Ok(phi(z))),
//!         Ask::Go { z } => scan.arrived(z),
//!         Ask::Ended(outcome) => break outcome,
//!         Ask::Sweep { .. } | Ask::Wait => unreachable!("a stepwise scan"),
//!     };
//! };
//! assert_eq!(outcome, Outcome::Focused);
//! assert!((scan.summary().best.0 - 30_000).abs() < 100);
//! ```

pub mod climb;
pub mod curve;
pub mod noise;
pub mod peak;

use climb::Climb;
use curve::{Curve, Place, STRIDE};
use parfocal_protocol::autofocus::{FrameFault, Mode, Outcome, ScanParameters, ScanRefusal};
use parfocal_protocol::message::{Field, Refusal};
use parfocal_protocol::units::{FocusValue, Nanometres};

/// What a scan wants next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ask {
    /// Stop at `z`, settle, and tell a value from there ([`Scan::sample`]). The same `z` again means one more frame.
    Sample {
        /// Where.
        z: Nanometres,
    },
    /// Move at constant speed to `to`, replacing the leg that runs, if any; tell values as they come, then
    /// [`Scan::arrived`].
    Sweep {
        /// End of the leg.
        to: Nanometres,
    },
    /// Move to `z` without samples, ending a sweep; then tell [`Scan::arrived`].
    Go {
        /// Where.
        z: Nanometres,
    },
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

/// Where a search wants its next frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// A frame at this place.
    Sample(Place),
    /// Enough is seen.
    Enough,
}

/// How to look for a peak: one state machine, asked after each value.
pub trait Search {
    /// Where the next frame should be taken, given the curve and where the axis is.
    fn next(&mut self, curve: &Curve, here: Place) -> Next;
}

/// Frames without a value in a row, before the scan gives up.
const FAULTS: u8 = 3;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    Searching,
    Leaving(Outcome),
    Ended(Outcome),
}

/// A running scan.
#[derive(Clone, Debug)]
pub struct Scan {
    curve: Curve,
    pub search: Climb,
    start: Nanometres,
    here: Nanometres,
    wanted: Nanometres,
    best: Nanometres,
    travel: i32,
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
        let search = Climb::new(curve.places(parameters.trap), curve.places(parameters.probe));
        let scan = Self {
            curve,
            search,
            start: z0,
            here: z0,
            wanted: z0,
            best: z0,
            travel: 0,
            faults: 0,
            stage: Stage::Searching,
        };
        Ok((scan, Ask::Sample { z: z0 }))
    }

    /// Takes in a value, or why there is none, from `z`; in a sweep in the order of exposure.
    pub fn sample(&mut self, z: Nanometres, value: Result<FocusValue, FrameFault>) -> Ask {
        if self.stage != Stage::Searching {
            return self.repeat();
        }
        self.reach(z);
        match value {
            Ok(value) if value.0.is_finite() => {
                self.faults = 0;
                self.curve.add(z, value);
            }
            fault => {
                self.faults += 1;
                if self.faults == FAULTS {
                    return self.abort(match fault {
                        Err(FrameFault::Blank) => ScanRefusal::NoContrast,
                        Err(FrameFault::Saturated) => ScanRefusal::Saturated,
                        Err(FrameFault::Stale) => ScanRefusal::StaleFrames,
                        Err(FrameFault::NoFrame) | Ok(_) => ScanRefusal::SamplesStopped,
                    });
                }
                return Ask::Sample { z: self.wanted };
            }
        }
        match self.search.next(&self.curve, self.curve.place(z)) {
            Next::Sample(place) => {
                self.wanted = self.curve.position(place);
                Ask::Sample { z: self.wanted }
            }
            Next::Enough => self.conclude(),
        }
    }

    /// A move without a sample, or a leg of a sweep, is over: the axis rests at `z`.
    pub fn arrived(&mut self, z: Nanometres) -> Ask {
        self.reach(z);
        if let Stage::Leaving(outcome) = self.stage {
            self.stage = Stage::Ended(outcome);
        }
        self.repeat()
    }

    /// Ends the scan for a reason from outside; it wants to return to its start.
    pub fn abort(&mut self, why: ScanRefusal) -> Ask {
        if self.stage == Stage::Searching {
            self.best = self.curve.best().map_or(self.start, |c| self.curve.position(c.place));
            self.wanted = self.start;
            self.stage = Stage::Leaving(Outcome::Refused(why));
        }
        self.repeat()
    }

    /// What is known of it by now.
    pub fn summary(&self) -> Summary {
        Summary {
            outcome: match self.stage {
                Stage::Ended(outcome) => Some(outcome),
                Stage::Searching | Stage::Leaving(_) => None,
            },
            start: self.start,
            best: self.best,
            travel: Nanometres(self.travel),
            frames: self.curve.frames(),
        }
    }

    fn repeat(&self) -> Ask {
        match self.stage {
            Stage::Searching => Ask::Sample { z: self.wanted },
            Stage::Leaving(_) => Ask::Go { z: self.wanted },
            Stage::Ended(outcome) => Ask::Ended(outcome),
        }
    }

    fn reach(&mut self, z: Nanometres) {
        self.travel = self.travel.saturating_add((z.0 - self.here.0).abs());
        self.here = z;
    }

    fn conclude(&mut self) -> Ask {
        let Some(best) = self.curve.best().copied() else {
            return self.abort(ScanRefusal::SamplesStopped);
        };
        let floor = (self.curve.lowest().0..=self.curve.highest().0)
            .filter_map(|p| self.curve.at(Place(p)))
            .fold(best.mean, |least, c| if c.mean < least { c.mean } else { least });
        let height = best.mean - floor;
        if height <= 0.0 {
            return self.abort(ScanRefusal::NoContrast);
        }
        let (first, last) = (self.curve.first(), self.curve.last());
        let falls = |end: Place| self.curve.at(end).is_none_or(|c| best.mean - c.mean >= 0.05 * height);
        if best.place.0 <= first.0 + STRIDE || best.place.0 >= last.0 - STRIDE || !falls(first) || !falls(last) {
            return self.abort(ScanRefusal::PeakAtEdge);
        }
        let sigma = self.curve.noise().relative();
        let b = self.search.best_place().unwrap_or(best.place.0);
        let Some(peak) = peak::find(&self.curve, (b - 80).max(self.curve.lowest().0), (b + 80).min(self.curve.highest().0), if sigma > self.search.tuning.quiet { sigma } else { 0.0 }, self.search.tuning.bias) else { return self.abort(ScanRefusal::NoSignificantPeak) };
        let step = self.curve.position(Place(1)).0 - self.curve.position(Place(0)).0;
        let at = peak.at * f64::from(step);
        self.best = Nanometres(self.start.0 + at as i32);
        self.wanted = self.best;
        self.stage = Stage::Leaving(Outcome::Focused);
        self.repeat()
    }
}

fn check(p: &ScanParameters, z0: Nanometres) -> Result<(), Refusal> {
    let within = |field: Field, value: f32, low: f32, high: f32| {
        if value >= low && value <= high { Ok(()) } else { Err(Refusal::OutOfRange { field, low, high }) }
    };
    let um = |z: Nanometres| z.0 as f32 / 1000.0;
    let span = i64::from(p.high.0) - i64::from(p.low.0);
    within(Field::ScanRange, span as f32 / 1000.0, um(p.sample_step).max(0.001), 100_000.0)?;
    if z0 < p.low || z0 > p.high {
        return Err(Refusal::OutOfRange { field: Field::ScanRange, low: um(p.low), high: um(p.high) });
    }
    within(Field::SampleStep, um(p.sample_step), (span as f32 / 1000.0 / 30_000.0).max(0.001), span as f32 / 2000.0)?;
    within(Field::Trap, um(p.trap), um(p.sample_step), um(p.sample_step) * (curve::CELLS as f32 / 4.0 - 16.0).max(1.0))
        .or_else(|e| if i64::from(p.trap.0) > span { Ok(()) } else { Err(e) })?;
    within(Field::Probe, um(p.probe), um(p.sample_step), span as f32 / 1000.0)?;
    within(Field::Speed, p.speed.0, 0.0, 100_000.0)?;
    within(Field::SampleTimeout, p.sample_timeout.0 as f32, 1.0, 600_000.0)?;
    match p.mode {
        Mode::Step => Ok(()),
        Mode::Sweep => Err(Refusal::Unsupported),
    }
}
