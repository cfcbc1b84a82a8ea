//! Focus values from recordings: the planes of a stack, or a curve.

use super::source::{FocusSource, Judged, SourceError, Wanted, judge};
use crate::focus::Measure;
use crate::frames::curve::Curve;
use crate::frames::stack::Stack;
use crate::picture::Roi;
use parfocal_protocol::autofocus::FrameFault;
use parfocal_protocol::units::FocusValue;

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
    fn value(&mut self, wanted: Wanted) -> Result<Judged, SourceError> {
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
    fn value(&mut self, wanted: Wanted) -> Result<Judged, SourceError> {
        Ok(Ok(FocusValue(self.0.value(wanted.z))))
    }
}
