//! The calibration: one peak swept over in both directions, at two speeds, several times.

use super::{BothWays, Delays, LEAST_RATIO, separate};
use crate::autofocus::plan::{AutofocusError, Plan, Span, focus};
use crate::autofocus::run::Progress;
use crate::autofocus::source::{CameraSource, FocusSource, SourceError};
use crate::frames::camera::Camera;
use crate::frames::pacing::{Edge, Latency, Pacing};
use crate::link::explain::scan_refusal;
use crate::stage::Stage;
use parfocal_protocol::autofocus::{Mode, Outcome, ScanRefusal, Strategy};
use parfocal_protocol::units::{Micrometres, MicrometresPerSecond, Nanometres};
use thiserror::Error;

/// How a latency is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LatencyPlan {
    /// The axis, measure of lengths and the like, as for a focus; its peak must be near [`LatencyPlan::peak`].
    pub focus: Plan,
    /// Where the peak is.
    pub peak: Micrometres,
    /// How far to both sides a sweep goes, beside what the latency itself takes.
    pub reach: Micrometres,
    /// The lower speed.
    pub slow: MicrometresPerSecond,
    /// The higher speed, at least [`LEAST_RATIO`] times the lower one.
    pub fast: MicrometresPerSecond,
    /// How often all four sweeps are made: two at least give an error.
    pub repeats: u32,
}

/// A latency that was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibrated {
    /// What to date frames with; for a camera that tells its exposures: how wrong it tells them.
    pub latency: Latency,
    /// Standard error of the latency, µs, from the repetitions.
    pub error_us: f64,
    /// Backlash that the board does not know of, µm.
    pub backlash_um: f64,
    /// Standard error of it.
    pub backlash_error_um: f64,
    /// Whether the camera tells its exposures, and so does not need the latency.
    pub told: bool,
    /// Frames of pacing that went before.
    pub frames: usize,
    /// The peaks that were found, slow and fast by turns.
    pub sweeps: Vec<BothWays>,
}

/// Why no latency was measured.
#[derive(Debug, Error)]
pub enum LatencyError {
    /// The two speeds are too alike.
    #[error(
        "{slow} and {fast} µm/s are too alike to tell latency from backlash: give two speeds above 0, the higher at least {LEAST_RATIO} times the lower"
    )]
    Speeds {
        /// The lower one, µm/s.
        slow: f32,
        /// The higher one.
        fast: f32,
    },
    /// No sweeps at all.
    #[error("at least 2 repetitions tell how well the latency is known")]
    Repeats,
    /// A sweep found no peak.
    #[error(
        "the sweep towards {to} at {speed} µm/s found no focus, {reason}: focus with --mode step first, on something with one clear peak"
    )]
    Refused {
        /// larger or smaller z.
        to: &'static str,
        /// The speed, µm/s.
        speed: f32,
        /// Why.
        reason: &'static str,
    },
    /// The sweeps contradict each other.
    #[error(
        "the repetitions differ too much: latency {latency_ms:.1} ± {error_ms:.1} ms. Let the sample come to rest, choose a sharper peak, or repeat more often"
    )]
    Uncertain {
        /// The latency, ms.
        latency_ms: f64,
        /// Its standard error, ms.
        error_ms: f64,
    },
    /// A sweep could not be made.
    #[error(transparent)]
    Autofocus(#[from] AutofocusError),
}

impl From<SourceError> for LatencyError {
    fn from(error: SourceError) -> Self {
        Self::Autofocus(error.into())
    }
}

/// Largest delay that sweeps make room for, s.
const ROOM_S: f64 = 0.2;

/// Frames that must have come before an uneven camera's steadier edge is chosen.
const TO_CHOOSE: usize = 600;

/// A standard error beyond this is none, µs: 1 µm at 100 µm/s.
const UNCERTAIN_US: f64 = 10_000.0;

/// Measures how late a camera's frames come, and what backlash the board does not know of. The source dates its frames with
/// the result from then on.
///
/// # Errors
/// [`LatencyError`].
pub fn measure<C: Camera>(
    stage: &mut Stage,
    source: &mut CameraSource<C>,
    plan: &LatencyPlan,
    progress: &mut dyn FnMut(Progress),
    keep_on: &dyn Fn() -> bool,
) -> Result<Calibrated, LatencyError> {
    let (slow, fast) = (plan.slow.0, plan.fast.0);
    if !(slow > 0.0 && fast.is_finite() && fast >= LEAST_RATIO as f32 * slow) {
        return Err(LatencyError::Speeds { slow, fast });
    }
    if plan.repeats < 2 {
        return Err(LatencyError::Repeats);
    }
    let guess = first_guess(stage, source, plan.fast, progress, keep_on)?;
    source.dating_mut().set_latency(Some(guess));
    let (mut sweeps, mut delays): (Vec<BothWays>, Vec<Delays>) = Default::default();
    for _ in 0..plan.repeats {
        let mut both = |speed: MicrometresPerSecond| -> Result<BothWays, LatencyError> {
            let mut towards = |up| sweep(stage, source, plan, speed, up, progress, keep_on);
            Ok(BothWays { speed, up: towards(true)?, down: towards(false)? })
        };
        let (slow, fast) = (both(plan.slow)?, both(plan.fast)?);
        sweeps.extend([slow, fast]);
        delays.extend(separate(&slow, &fast));
    }
    let (late_s, error_s) = mean(delays.iter().map(|d| d.latency_s));
    let (backlash_um, backlash_error_um) = mean(delays.iter().map(|d| d.backlash_um));
    let latency = Latency { late_us: guess.late_us + late_s * 1e6, ..guess };
    let error_us = error_s * 1e6;
    if !(error_us <= UNCERTAIN_US) {
        return Err(LatencyError::Uncertain { latency_ms: latency.late_us / 1e3, error_ms: error_us / 1e3 });
    }
    let told = source.dating().told();
    source.dating_mut().set_latency(Some(latency));
    let frames = source.dating().pacing().frames();
    Ok(Calibrated { latency, error_us, backlash_um, backlash_error_um, told, frames, sweeps })
}

/// Learns the camera's pace and which edge of the arrivals keeps it, and dates frames early enough not to lie in the future.
fn first_guess<C: Camera>(
    stage: &Stage,
    source: &mut CameraSource<C>,
    fast: MicrometresPerSecond,
    progress: &mut dyn FnMut(Progress),
    keep_on: &dyn Fn() -> bool,
) -> Result<Latency, LatencyError> {
    let nothing = Latency { late_us: 0.0, period_us: 0.0, edge: Default::default() };
    // Any latency will do to be let through; its pace is set below.
    source.dating_mut().set_latency(Some(nothing));
    let frames = source.ready(stage.now(), None, progress, keep_on)?;
    if source.dating().told() {
        return Ok(Latency { period_us: frames.period_us(), ..nothing });
    }
    // Equal steps of patience: an even camera is understood after a few frames, an uneven one needs its hundreds.
    let mut now = stage.now();
    while source.dating().pacing().frames() < TO_CHOOSE && spread_us(source.dating().pacing()) > 1_000.0 {
        if !keep_on() {
            return Err(SourceError::Interrupted.into());
        }
        now = source.watch(now.max(stage.now()))?.arrival;
        let frames = source.dating().pacing().frames();
        progress(Progress::Pacing { frames, doubt_us: spread_us(source.dating().pacing()) });
    }
    let pacing = source.dating().pacing();
    let edge = pacing.sharper().unwrap_or_default();
    let period_us = pacing.clock(edge).map_or(frames.period_us(), |clock| clock.period_us);
    let guess = Latency { late_us: 0.0, period_us, edge };
    source.dating_mut().set_latency(Some(guess));
    source.ready(stage.now(), Some(fast), progress, keep_on)?;
    let pacing = source.dating().pacing();
    let period_us = pacing.clock(edge).map_or(period_us, |clock| clock.period_us);
    let late_us = match edge {
        Edge::Earliest => 0.0,
        Edge::Latest => spread_us(pacing),
    };
    Ok(Latency { late_us, period_us, edge })
}

/// How far the latest arrivals are behind the earliest, µs.
fn spread_us(pacing: &Pacing) -> f64 {
    let (Some(early), Some(late)) = (pacing.clock(Edge::Earliest), pacing.clock(Edge::Latest)) else { return f64::MAX };
    let middle = pacing.middle();
    (late.time(middle).0 as f64 - early.time(middle).0 as f64).max(0.0)
}

/// One sweep over the peak from one end; where the board sees it.
fn sweep<C: Camera>(
    stage: &mut Stage,
    source: &mut CameraSource<C>,
    plan: &LatencyPlan,
    speed: MicrometresPerSecond,
    up: bool,
    progress: &mut dyn FnMut(Progress),
    keep_on: &dyn Fn() -> bool,
) -> Result<Nanometres, LatencyError> {
    let axis = plan.focus.axis;
    let settings = stage.settings(axis).map_err(AutofocusError::from)?;
    let reach = plan.reach.0 + f64::from(speed.0) * ROOM_S;
    let low = (plan.peak.0 - reach).max(settings.low.micrometres().0);
    let high = (plan.peak.0 + reach).min(settings.high.micrometres().0);
    let start = if up { low } else { high };
    let around = Span { low: Micrometres(low - start), high: Micrometres(high - start) };
    let one = Plan {
        start: Some(Micrometres(start)),
        range: Some(around),
        strategy: Strategy::Scan,
        mode: Mode::Sweep,
        speed: Some(speed),
        verify: false,
        ..plan.focus
    };
    let report = focus(stage, source, &one, progress, keep_on)?.report;
    match report.outcome {
        Outcome::Focused => Ok(report.best),
        Outcome::Refused(ScanRefusal::Aborted) => Err(SourceError::Interrupted.into()),
        Outcome::Refused(why) => {
            let to = if up { "larger z" } else { "smaller z" };
            Err(LatencyError::Refused { to, speed: speed.0, reason: scan_refusal(why) })
        }
    }
}

/// Mean and its standard error; infinite for a single value.
fn mean(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let n = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / n;
    let squares = values.map(|v| (v - mean).powi(2)).sum::<f64>();
    (mean, if n > 1.0 { (squares / (n - 1.0) / n).sqrt() } else { f64::INFINITY })
}
