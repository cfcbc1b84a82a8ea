//! Where focus values come from: a camera's frames, the planes of a stack, or a curve.

use crate::focus::quality::Quality;
use crate::focus::{self, Measure};
use crate::frames::camera::{Camera, CameraError};
use crate::frames::curve::Curve;
use crate::frames::stack::Stack;
use crate::picture::{PictureError, Roi, View};
use parfocal_protocol::autofocus::FrameFault;
use parfocal_protocol::units::{FocusValue, HostTime, Micrometres};
use thiserror::Error;

/// What the board asks a value for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Where the axis rests.
    pub z: Micrometres,
    /// Since when, by the host's clock: an exposure that began earlier shows the move.
    pub since: HostTime,
    /// Until when to wait for a frame.
    pub deadline: HostTime,
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
}

/// Gives one value for each place the board stops at.
pub trait FocusSource {
    /// The value at `wanted`, or what is wrong with the picture there.
    ///
    /// # Errors
    /// [`SourceError`] when no later picture will be better.
    fn value(&mut self, wanted: Wanted) -> Result<Result<FocusValue, FrameFault>, SourceError>;
}

/// Measures the focus of one picture's region, unless the picture is blank or saturated.
///
/// # Errors
/// The region does not fit, or the measure cannot be computed on it.
pub fn judge(
    view: View<'_>,
    roi: Option<Roi>,
    measure: Measure,
) -> Result<Result<FocusValue, FrameFault>, SourceError> {
    let region = roi.map_or(Ok(view), |roi| view.crop(roi))?;
    match Quality::of(region).fault() {
        Some(fault) => Ok(Err(fault)),
        None => Ok(Ok(focus::measure(region, measure)?)),
    }
}

/// Focus values from a live camera.
pub struct CameraSource<C> {
    /// The camera.
    pub camera: C,
    /// The region whose focus matters; the whole frame without one.
    pub roi: Option<Roi>,
    /// The focus measure.
    pub measure: Measure,
}

/// Frames from before the move that are thrown away before a camera counts as showing only old ones.
const STALE: u32 = 32;

impl<C: Camera> FocusSource for CameraSource<C> {
    fn value(&mut self, wanted: Wanted) -> Result<Result<FocusValue, FrameFault>, SourceError> {
        for _ in 0..STALE {
            let Some(frame) = self.camera.next_frame(wanted.deadline)? else { return Ok(Err(FrameFault::NoFrame)) };
            // Without exposure times the arrival is all there is: the frame that arrives next may be an old one,
            // so the first one after the move is not trusted (see `frames::pacing` for calibrated latencies).
            let begin = frame.exposure.map_or(frame.arrival, |(begin, _)| begin);
            if begin >= wanted.since {
                return judge(frame.picture.view(), self.roi, self.measure);
            }
        }
        Ok(Err(FrameFault::Stale))
    }
}

/// Focus values from a recorded stack: each plane's value, linear in z between planes.
pub struct StackSource {
    stack: Stack,
    values: Vec<f64>,
    faults: Vec<Option<FrameFault>>,
}

impl StackSource {
    /// Measures every plane.
    ///
    /// # Errors
    /// As [`judge`].
    pub fn new(stack: Stack, roi: Option<Roi>, measure: Measure) -> Result<Self, SourceError> {
        let (mut values, mut faults) = (Vec::new(), Vec::new());
        for plane in &stack.planes {
            let judged = judge(plane.view(), roi, measure)?;
            values.push(judged.map_or(0.0, |v| v.0));
            faults.push(judged.err());
        }
        Ok(Self { stack, values, faults })
    }

    /// The stack.
    pub fn stack(&self) -> &Stack {
        &self.stack
    }
}

impl FocusSource for StackSource {
    fn value(&mut self, wanted: Wanted) -> Result<Result<FocusValue, FrameFault>, SourceError> {
        // Shown is the nearest plane, so its faults count.
        if let Some(fault) = self.faults[self.stack.nearest(wanted.z)] {
            return Ok(Err(fault));
        }
        Ok(self.stack.between(&self.values, wanted.z).map(FocusValue).ok_or(FrameFault::NoFrame))
    }
}

/// Focus values from a curve.
pub struct CurveSource(pub Curve);

impl FocusSource for CurveSource {
    fn value(&mut self, wanted: Wanted) -> Result<Result<FocusValue, FrameFault>, SourceError> {
        Ok(Ok(FocusValue(self.0.value(wanted.z))))
    }
}
