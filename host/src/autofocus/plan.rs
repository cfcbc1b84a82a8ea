//! What to focus and how; from there to the board's parameters.

use super::run::{Progress, ScanError, Scanned, run};
use super::source::{FocusSource, SourceError};
use crate::rig::AxisName;
use crate::stage::{Stage, StageError};
use parfocal_protocol::autofocus::{Mode, ScanId, ScanParameters, Strategy, Subject};
use parfocal_protocol::units::{Axis, Micrometres, MicrometresPerSecond, Milliseconds};
use thiserror::Error;

/// A span of positions, low end first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Its low end.
    pub low: Micrometres,
    /// Its high end.
    pub high: Micrometres,
}

/// What to focus, and how. [`Plan::new`] has what suits a pipette's tip under a 40x objective; all lengths belong to the
/// objective, in depths of field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// The axis that moves: the lens, or a manipulator's z.
    pub axis: AxisName,
    /// Where to begin; where it is, without.
    pub start: Option<Micrometres>,
    /// How far to look, relative to the start, clipped to the soft limits; without: those limits, at most [`REACH`] away.
    pub range: Option<Span>,
    /// Where pictures exist, if not everywhere: a recording's extent.
    pub extent: Option<Span>,
    /// How the peak is looked for.
    pub strategy: Strategy,
    /// Stop for every frame, or measure while moving.
    pub mode: Mode,
    /// The kind of curve.
    pub subject: Subject,
    /// Distance between samples; 0.5 µm without. A sweep has as many as the board keeps.
    pub sample_step: Option<Micrometres>,
    /// All local maxima lie within this distance of the focus.
    pub trap: Micrometres,
    /// First step to find the uphill direction.
    pub probe: Micrometres,
    /// Speed between samples, or of a sweep; without: the axis' own, or five frames to a trap radius.
    pub speed: Option<MicrometresPerSecond>,
    /// Take a last frame at the result and compare it with the best seen.
    pub verify: bool,
}

/// How far a scan looks to either side if nobody says, µm: manipulators travel centimetres.
pub const REACH: Micrometres = Micrometres(500.0);

/// Distance between samples if nobody says.
const STEP: Micrometres = Micrometres(0.5);

/// Sample steps that the board keeps of a sweep, see `firmware/src/autofocus/parameters.rs`.
const SWEPT: f64 = 253.0;

/// Frames in a trap radius: in a sweep at a speed that nobody chose, and in the fastest one.
const FRAMES: [f64; 2] = [5.0, 2.0];

/// Half a nanometre, µm: what the link rounds away.
const ROUNDED: f64 = 5e-4;

/// Why an axis could not be focused. A scan that the board refuses is not an error: its report says why.
#[derive(Debug, Error)]
pub enum AutofocusError {
    /// The scan.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// The axis, or the way to its start.
    #[error(transparent)]
    Stage(#[from] StageError),
    /// The recording and the axis have no position in common.
    #[error("the source covers no part of {axis}'s travel of {low} to {high} µm: choose another --range or --start")]
    NoTravel {
        /// The axis.
        axis: AxisName,
        /// Lowest position asked for, µm.
        low: f64,
        /// Highest one.
        high: f64,
    },
    /// The start lies outside.
    #[error("--start {start} lies outside {low} to {high} µm, where {axis} can go and pictures exist")]
    StartOutside {
        /// The axis.
        axis: AxisName,
        /// Where to begin, µm.
        start: f64,
        /// Lowest position possible.
        low: f64,
        /// Highest one.
        high: f64,
    },
    /// A length that no stage has.
    #[error("{name} of {um} µm is no length a stage can have")]
    NoLength {
        /// What it is.
        name: &'static str,
        /// Its value.
        um: f64,
    },
    /// A speed that is none.
    #[error("a speed of {0} µm/s is none: give one above 0, or none at all")]
    NoSpeed(f32),
    /// A sweep too fast for the camera.
    #[error(
        "at {speed} µm/s the camera's {hz:.1} frames/s lie {apart:.1} µm apart: too few for a trap radius of {trap} µm. Sweep at {fastest:.0} µm/s or slower, or set the camera faster"
    )]
    TooFast {
        /// The speed asked for, µm/s.
        speed: f32,
        /// Frames in a second.
        hz: f64,
        /// Way between two frames, µm.
        apart: f64,
        /// The trap radius, µm.
        trap: f64,
        /// The fastest speed, µm/s.
        fastest: f64,
    },
}

impl From<SourceError> for AutofocusError {
    fn from(error: SourceError) -> Self {
        Self::Scan(error.into())
    }
}

impl Plan {
    /// A climb from where the axis is, stopping for every frame.
    pub fn new(axis: AxisName) -> Self {
        Self {
            axis,
            start: None,
            range: None,
            extent: None,
            strategy: Strategy::Climb,
            mode: Mode::Step,
            subject: Subject::Peak,
            sample_step: None,
            trap: Micrometres(10.0),
            probe: Micrometres(5.0),
            speed: None,
            verify: false,
        }
    }

    /// What the board is told, from a start at `start` on an axis that may go through `travel`, at `speed` (0: its own).
    fn parameters(
        &self,
        axis: Axis,
        start: Micrometres,
        travel: Span,
        speed: MicrometresPerSecond,
    ) -> Result<ScanParameters, AutofocusError> {
        let around = self.range.unwrap_or(Span { low: Micrometres(-REACH.0), high: REACH });
        let low = travel.low.0.max(start.0 + around.low.0);
        let high = travel.high.0.min(start.0 + around.high.0);
        let mut step = self.sample_step.unwrap_or(STEP).0;
        if self.mode == Mode::Sweep {
            step = step.max((high - low) / SWEPT);
        }
        let nm = |name, um: f64| Micrometres(um).nanometres().ok_or(AutofocusError::NoLength { name, um });
        Ok(ScanParameters {
            scan: ScanId(rand::random()),
            axis,
            strategy: self.strategy,
            mode: self.mode,
            subject: self.subject,
            low: nm("the range's low end", low)?,
            high: nm("the range's high end", high)?,
            sample_step: nm("--sample-step-um", step)?,
            trap: nm("--trap-um", self.trap.0)?,
            probe: nm("--probe-um", self.probe.0)?.max(nm("--sample-step-um", step)?),
            speed,
            sample_timeout: Milliseconds(2000),
            verify: self.verify,
        })
    }

    /// A sweep's speed: the one asked for if the camera can follow, else one that it can.
    fn sweep_speed(&self, period_us: f64, axis: MicrometresPerSecond) -> Result<MicrometresPerSecond, AutofocusError> {
        let at = |frames: f64| self.trap.0 / frames / (period_us.max(1.0) * 1e-6);
        let [ample, fewest] = FRAMES.map(at);
        match self.speed {
            None => Ok(MicrometresPerSecond(axis.0.min(ample as f32))),
            Some(speed) if f64::from(speed.0) > fewest * 1.000_1 => Err(AutofocusError::TooFast {
                speed: speed.0,
                hz: 1e6 / period_us,
                apart: f64::from(speed.0) * period_us * 1e-6,
                trap: self.trap.0,
                fastest: fewest.floor(),
            }),
            Some(speed) => Ok(speed),
        }
    }
}

/// Focuses an axis and tells how it went: moves to the plan's start, runs the scan on the axis' board, answers with the source's
/// values. `progress` is told every sample as it comes; `keep_on` is asked all the while, and false ends the scan, which
/// then returns to its start.
///
/// ```no_run
/// # fn demo(
/// #     stage: &mut parfocal::stage::Stage, camera: &mut dyn parfocal::frames::camera::Camera,
/// # ) -> Result<(), Box<dyn std::error::Error>> {
/// use parfocal::autofocus::{CameraSource, Plan, Progress, focus};
/// use parfocal::focus::Measure;
///
/// let mut source = CameraSource::new(camera, Some("300,220,48,48".parse()?), Measure::Tenengrad, None);
/// let plan = Plan { verify: true, ..Plan::new("scope.z".parse()?) };
/// let mut progress = |told: Progress| println!("{told:?}");
/// let scanned = focus(stage, &mut source, &plan, &mut progress, &|| true)?;
/// println!("{:?} at {:?}", scanned.report.outcome, scanned.report.end);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// [`AutofocusError`]. A refused scan is not an error: the report says why.
pub fn focus(
    stage: &mut Stage,
    source: &mut dyn FocusSource,
    plan: &Plan,
    progress: &mut dyn FnMut(Progress),
    keep_on: &dyn Fn() -> bool,
) -> Result<Scanned, AutofocusError> {
    let axis = plan.axis;
    if let Some(speed) = plan.speed.filter(|s| !(s.0 > 0.0 && s.0.is_finite())) {
        return Err(AutofocusError::NoSpeed(speed.0));
    }
    let settings = stage.settings(axis)?;
    let mut travel = Span { low: settings.low.micrometres(), high: settings.high.micrometres() };
    if let Some(extent) = plan.extent {
        travel.low.0 = travel.low.0.max(extent.low.0);
        travel.high.0 = travel.high.0.min(extent.high.0);
    }
    let Span { low: Micrometres(low), high: Micrometres(high) } = travel;
    if low >= high {
        return Err(AutofocusError::NoTravel { axis, low, high });
    }
    let speed = match plan.mode {
        Mode::Step => plan.speed.unwrap_or(MicrometresPerSecond(0.0)),
        Mode::Sweep => {
            let frames = source.ready(stage.now(), None, progress, keep_on)?;
            plan.sweep_speed(frames.period_us(), settings.speed)?
        }
    };
    if let Some(Micrometres(start)) = plan.start {
        if start < low - ROUNDED || start > high + ROUNDED {
            return Err(AutofocusError::StartOutside { axis, start, low, high });
        }
        if (stage.position(axis)?.0 - start).abs() > ROUNDED {
            stage.move_to(&[(axis, Micrometres(start))], None, keep_on)?;
        }
    }
    let start = stage.position(axis)?;
    let (link, index) = stage.find(axis)?;
    let parameters = plan.parameters(index, start, travel, speed)?;
    Ok(run(link, &parameters, source, progress, keep_on)?)
}
