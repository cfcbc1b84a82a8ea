//! The tip detector as a [`PointFinder`].

use super::point::{Found, FramePixel, Hint, NotFound, PointFinder, Subject, Witness};
use crate::frames::camera::Frame;
use crate::tip::{Expect, detect};

/// Finds pipette tips in single frames. The direction of the first two tips in a row of a subject that point the same way is what
/// it expects from then on: another manipulator's pipette comes from another side.
#[derive(Clone, Debug, Default)]
pub struct DetectorFinder {
    expect: Expect,
    /// Of which subject, and how its tip points.
    known: Option<(Subject, f64)>,
    /// The same of the tip found last: one tip alone may be a wrong one.
    last: Option<(Subject, f64)>,
}

/// Tips whose directions differ by no more point the same way, degrees.
const SAME_WAY_DEG: f64 = 15.0;

impl DetectorFinder {
    /// A detector that expects this: the direction that the first tip points to, and how sure to be.
    pub fn new(expect: Expect) -> Self {
        Self { expect, known: None, last: None }
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
            let now = Some((hint.subject.clone(), tip.angle_deg));
            let same = |(subject, angle): &(Subject, f64)| {
                let apart = (angle - tip.angle_deg + 180.0).rem_euclid(360.0) - 180.0;
                *subject == hint.subject && apart.abs() <= SAME_WAY_DEG
            };
            if self.last.as_ref().is_some_and(same) {
                self.known.clone_from(&now);
            }
            self.last = now;
        }
        Ok(found)
    }
}
