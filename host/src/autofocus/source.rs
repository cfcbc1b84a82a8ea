//! Where focus values come from: a camera's frames, or a recording ([`super::recorded`]).

use super::dating::{Dating, Undated};
use super::run::Progress;
use crate::focus::quality::Quality;
use crate::focus::{self, Measure};
use crate::frames::camera::{Camera, CameraError, Stamp};
use crate::frames::pacing::Latency;
use crate::link::transport::later;
use crate::picture::{PictureError, Roi, View};
use parfocal_protocol::autofocus::FrameFault;
use parfocal_protocol::units::{FocusValue, HostTime, Micrometres, MicrometresPerSecond};
use thiserror::Error;

/// What the board asks a value for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Where the axis rests, or was at that moment in a sweep through a recording.
    pub z: Micrometres,
    /// Since when, by the host's clock: an exposure that began earlier shows the move.
    pub since: HostTime,
    /// Until when to wait for a frame.
    pub deadline: HostTime,
}

/// A value, or what is wrong with its picture.
pub type Judged = Result<FocusValue, FrameFault>;

/// One value of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dated {
    /// The middle of the exposure.
    pub middle: HostTime,
    /// The value, or why there is none.
    pub value: Judged,
}

/// How a source's frames come in a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Frames {
    /// One after the other by themselves: [`FocusSource::next`] waits for them.
    Live {
        /// Time between two, µs.
        period_us: f64,
    },
    /// A recording: [`FocusSource::value`] at the places where the axis is.
    Replayed {
        /// Time between two, µs.
        period_us: f64,
    },
}

impl Frames {
    /// Time between two frames, µs.
    pub fn period_us(&self) -> f64 {
        match self {
            Self::Live { period_us } | Self::Replayed { period_us } => *period_us,
        }
    }
}

/// Why a source gives no values at all. A single bad frame is a [`FrameFault`] instead.
#[derive(Debug, Error)]
pub enum SourceError {
    /// The camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The region does not fit its pictures.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// The measure cannot be computed on such pictures.
    #[error(transparent)]
    Measure(#[from] focus::FocusError),
    /// No exposure times, and nothing to make up for them.
    #[error(
        "the camera {camera} does not say when its frames were exposed, and its latency is not calibrated: run `parfocal calibrate latency --rig FILE` once and give --rig FILE, or focus with --mode step"
    )]
    Uncalibrated {
        /// The camera.
        camera: String,
    },
    /// The camera runs at another rate than at its calibration.
    #[error(
        "the camera {camera} gives {now_hz:.2} frames/s, its latency was calibrated at {calibrated_hz:.2}: set that rate, or run `parfocal calibrate latency` again"
    )]
    OtherPace {
        /// The camera.
        camera: String,
        /// Frames in a second now.
        now_hz: f64,
        /// Frames in a second then.
        calibrated_hz: f64,
    },
    /// Frames come so unevenly that their exposure cannot be told from the arrivals.
    #[error(
        "frames of the camera {camera} come so unevenly that after {frames} of them their exposure is known to {doubt_ms:.1} ms only: sweep below {fastest:.3} µm/s, or focus with --mode step"
    )]
    Uneven {
        /// The camera.
        camera: String,
        /// Frames looked at.
        frames: usize,
        /// What is known.
        doubt_ms: f64,
        /// A speed at which that is enough, µm/s.
        fastest: f64,
    },
    /// A person asked to stop.
    #[error("stopped on request, before anything moved")]
    Interrupted,
}

/// Gives focus values.
pub trait FocusSource {
    /// The value at `wanted`, where the axis rests, or what is wrong with the picture there.
    ///
    /// # Errors
    /// [`SourceError`] when no later picture will be better.
    fn value(&mut self, wanted: Wanted) -> Result<Judged, SourceError>;

    /// Gets ready for a sweep: at `speed`, or at one still to be chosen. Says how frames come.
    ///
    /// # Errors
    /// [`SourceError`] when the frames of such a sweep could not be dated.
    fn ready(
        &mut self,
        now: HostTime,
        speed: Option<MicrometresPerSecond>,
        progress: &mut dyn FnMut(Progress),
        keep_on: &dyn Fn() -> bool,
    ) -> Result<Frames, SourceError> {
        let _ = (now, speed, progress, keep_on);
        Ok(Frames::Replayed { period_us: 10_000.0 })
    }

    /// The next frame of a sweep, waiting for it until `deadline`; `None` when none came, and for a recording.
    ///
    /// # Errors
    /// [`SourceError`].
    fn next(&mut self, deadline: HostTime) -> Result<Option<Dated>, SourceError> {
        let _ = deadline;
        Ok(None)
    }
}

/// Measures the focus of one picture's region, unless the picture is blank or saturated.
///
/// # Errors
/// The region does not fit, or the measure cannot be computed on it.
pub fn judge(view: View<'_>, roi: Option<Roi>, measure: Measure) -> Result<Judged, SourceError> {
    let region = roi.map_or(Ok(view), |roi| view.crop(roi))?;
    // First, so that a region too small for the measure is named as such.
    let value = focus::measure(region, measure)?;
    Ok(Quality::of(region).fault().map_or(Ok(value), Err))
}

/// Focus values from a live camera.
pub struct CameraSource<C> {
    /// The camera.
    pub camera: C,
    /// The region whose focus matters; the whole frame without one.
    pub roi: Option<Roi>,
    /// The focus measure.
    pub measure: Measure,
    dating: Dating,
}

/// How far a sweep may move while the time of a frame is in doubt, µm.
const DOUBT_UM: f64 = 0.04;

/// Frames after which the pace of an uneven camera is known well enough, or never.
const PATIENCE: usize = 3_600;

/// Frames that tell the time between frames, for a camera that says when it exposes, and for one that does not.
const TO_TELL_THE_RATE: [usize; 2] = [3, 40];

/// How long a running camera may take for one frame, ms.
const FRAME_MS: u64 = 2_000;

impl<C: Camera> CameraSource<C> {
    /// Values of `measure` in `roi` from a camera whose latency is known, or not: only one that tells no exposure times needs it.
    pub fn new(camera: C, roi: Option<Roi>, measure: Measure, latency: Option<Latency>) -> Self {
        Self { camera, roi, measure, dating: Dating::new(latency) }
    }

    /// When its frames are exposed.
    pub fn dating(&self) -> &Dating {
        &self.dating
    }

    /// The same, to put a latency in force.
    pub fn dating_mut(&mut self) -> &mut Dating {
        &mut self.dating
    }

    fn undated(&self, why: Undated) -> SourceError {
        let camera = self.camera.name();
        match why {
            Undated::Uncalibrated | Undated::TooEarly => SourceError::Uncalibrated { camera },
            Undated::OtherPace { calibrated_us, now_us } => {
                SourceError::OtherPace { camera, now_hz: 1e6 / now_us, calibrated_hz: 1e6 / calibrated_us }
            }
        }
    }

    /// Takes in the next frame's times, which must come.
    pub(super) fn watch(&mut self, now: HostTime) -> Result<Stamp, SourceError> {
        let stamp = self.camera.next_stamp(later(now, FRAME_MS))?;
        let stamp = stamp.ok_or_else(|| CameraError::Stalled { camera: self.camera.name(), millis: FRAME_MS })?;
        self.dating.see(&stamp);
        Ok(stamp)
    }
}

impl<C: Camera> FocusSource for CameraSource<C> {
    fn value(&mut self, wanted: Wanted) -> Result<Judged, SourceError> {
        let mut fault = FrameFault::NoFrame;
        if let Some(until) = self.dating.stale_until(wanted.since) {
            // What is stale by its arrival alone need not be decoded.
            while let Some(stamp) = self.camera.next_stamp(wanted.deadline)? {
                self.dating.see(&stamp);
                fault = FrameFault::Stale;
                if stamp.arrival >= until {
                    break;
                }
            }
        }
        while let Some((frame, part)) = self.camera.next_part(wanted.deadline, self.roi)? {
            let stamp = frame.stamp();
            self.dating.see(&stamp);
            if self.dating.earliest(&stamp) >= wanted.since {
                return judge(frame.picture.view(), part, self.measure);
            }
            fault = FrameFault::Stale;
            if frame.arrival >= wanted.deadline {
                break;
            }
        }
        Ok(Err(fault))
    }

    fn ready(
        &mut self,
        mut now: HostTime,
        speed: Option<MicrometresPerSecond>,
        progress: &mut dyn FnMut(Progress),
        keep_on: &dyn Fn() -> bool,
    ) -> Result<Frames, SourceError> {
        let mut seen: Vec<Stamp> = Vec::new();
        loop {
            if !keep_on() {
                return Err(SourceError::Interrupted);
            }
            let stamp = self.watch(now)?;
            // A frame may have waited in the camera's queue since long ago.
            now = now.max(stamp.arrival);
            let told = self.dating.told();
            if !told && self.dating.latency().is_none() {
                return Err(self.undated(Undated::Uncalibrated));
            }
            seen.push(stamp);
            let frames = self.dating.pacing().frames();
            let enough = if told { seen.len() >= TO_TELL_THE_RATE[0] } else { frames >= TO_TELL_THE_RATE[1] };
            if !enough {
                continue;
            }
            if told {
                return Ok(Frames::Live { period_us: exposed_every(&seen).unwrap_or(0.0) });
            }
            let edge = self.dating.latency().map(|l| l.edge).unwrap_or_default();
            let clock = self.dating.pacing().clock(edge);
            let Some((clock, speed)) = clock.zip(speed) else {
                return Ok(Frames::Live { period_us: self.dating.pacing().period_us().unwrap_or(0.0) });
            };
            let fastest = DOUBT_UM / (clock.doubt_us.max(1.0) * 1e-6);
            if f64::from(speed.0) <= fastest {
                self.dating.middle(&stamp).map_err(|why| self.undated(why))?;
                return Ok(Frames::Live { period_us: clock.period_us });
            }
            if frames >= PATIENCE {
                let (camera, doubt_ms) = (self.camera.name(), clock.doubt_us / 1000.0);
                return Err(SourceError::Uneven { camera, frames, doubt_ms, fastest });
            }
            progress(Progress::Pacing { frames, doubt_us: clock.doubt_us });
        }
    }

    fn next(&mut self, deadline: HostTime) -> Result<Option<Dated>, SourceError> {
        let Some((frame, part)) = self.camera.next_part(deadline, self.roi)? else { return Ok(None) };
        let stamp = frame.stamp();
        self.dating.see(&stamp);
        let middle = self.dating.middle(&stamp).map_err(|why| self.undated(why))?;
        Ok(Some(Dated { middle, value: judge(frame.picture.view(), part, self.measure)? }))
    }
}

/// Time between exposures, µs.
fn exposed_every(seen: &[Stamp]) -> Option<f64> {
    let ((first, last), (begin, end)) = {
        let (a, b) = (seen.first()?, seen.last()?);
        ((a.number, b.number), (a.exposure?.0, b.exposure?.0))
    };
    let frames = last.checked_sub(first).filter(|n| *n > 0)?;
    Some((end.0 as f64 - begin.0 as f64) / frames as f64)
}
