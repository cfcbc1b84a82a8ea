//! The tip detector as a [`PointFinder`].

use super::point::{Found, FramePixel, Hint, NotFound, PointFinder, Subject, Witness};
use crate::frames::camera::Frame;
use crate::tip::{Expect, detect};

/// Finds pipette tips in single frames. The direction of the first tip that it finds of a subject is what it expects from
/// then on: another manipulator's pipette comes from another side.
#[derive(Clone, Debug, Default)]
pub struct DetectorFinder {
    expect: Expect,
    /// Of which subject, and how its tip points.
    known: Option<(Subject, f64)>,
}

impl DetectorFinder {
    /// A detector that expects this: the direction that the first tip points to, and how sure to be.
    pub fn new(expect: Expect) -> Self {
        Self { expect, known: None }
    }
}

impl PointFinder for DetectorFinder {
    fn find(&mut self, frame: &Frame, hint: &Hint) -> Result<Found, NotFound> {
        let unseen = || NotFound::Unseen(hint.subject.clone());
        if matches!(hint.subject, Subject::Shank(_)) {
            return Err(unseen());
        }
        let known = self.known.as_ref().filter(|(subject, _)| *subject == hint.subject).map(|(_, angle)| *angle);
        let expect = Expect { angle_deg: hint.angle_deg.or(known).or(self.expect.angle_deg), ..self.expect };
        let tip = detect(&frame.picture.view(), &expect).ok_or_else(unseen)?;
        let found = Found {
            at: FramePixel { x_px: tip.x_px, y_px: tip.y_px },
            confidence: tip.confidence,
            angle_deg: Some(tip.angle_deg),
            by: Witness::Detector,
        };
        if known.is_none() && hint.allows(found.at) {
            self.known = Some((hint.subject.clone(), tip.angle_deg));
        }
        Ok(found)
    }
}
