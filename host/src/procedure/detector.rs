//! The tip detector as a [`PointFinder`].

use super::point::{Found, FramePixel, Hint, NotFound, PointFinder, Subject, Witness};
use crate::frames::camera::Frame;
use crate::tip::{Expect, detect};

/// Finds pipette tips in single frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct DetectorFinder {
    /// What the pipette looks like: the direction it points to, and how sure to be.
    pub expect: Expect,
}

impl PointFinder for DetectorFinder {
    fn find(&mut self, frame: &Frame, hint: &Hint) -> Result<Found, NotFound> {
        let unseen = || NotFound::Unseen(hint.subject.clone());
        if matches!(hint.subject, Subject::Shank(_)) {
            return Err(unseen());
        }
        let tip = detect(&frame.picture.view(), &self.expect).ok_or_else(unseen)?;
        Ok(Found {
            at: FramePixel { x_px: tip.x_px, y_px: tip.y_px },
            confidence: tip.confidence,
            angle_deg: Some(tip.angle_deg),
            by: Witness::Detector,
        })
    }
}
