//! What sees tips in frames.

use crate::frames::camera::Frame;
use crate::procedure::{Found, FramePixel, Witness};
use crate::tip::{Expect, detect_all};

/// Sees the tips of pipettes in frames.
pub trait Eyes {
    /// Every tip in a frame, the surest first.
    fn tips(&mut self, frame: &Frame) -> Vec<Found>;
}

/// The tip detector.
#[derive(Clone, Copy, Debug, Default)]
pub struct DetectorEyes {
    /// How sure to be.
    pub expect: Expect,
}

impl Eyes for DetectorEyes {
    fn tips(&mut self, frame: &Frame) -> Vec<Found> {
        let found = detect_all(&frame.picture.view(), &self.expect);
        found
            .into_iter()
            .map(|tip| Found {
                at: FramePixel { x_px: tip.x_px, y_px: tip.y_px },
                confidence: tip.confidence,
                angle_deg: Some(tip.angle_deg),
                by: Witness::Detector,
            })
            .collect()
    }
}
