//! From the first sight of a pipette to its tip: down along the shank, then into focus.

use super::view::View;
use super::{Hunt, SIGMAS, VISIBLE_DEPTHS};
use crate::calibration::chain::Pixel;
use crate::calibration::frames::Displacement;
use crate::procedure::error::ProcedureError;
use crate::procedure::guard::targets;
use crate::procedure::jog::Jogged;
use crate::procedure::live::Seen;
use crate::procedure::point::{Found, FramePixel, NotFound, Subject, Witness};
use crate::procedure::spiral::outwards;
use crate::rig::{AxisName, Coordinate, Device};
use nalgebra::Vector3;
use parfocal_protocol::units::Micrometres;

/// A step down along the shank: so many depths of field deep, and at most this share of the picture's shorter side long.
const DOWN_DEPTHS: f64 = 8.0;
const DOWN_SHARE: f64 = 0.25;
/// A shank's end that went on by less than this share of two steps is the tip.
const STAYS: f64 = 0.5;
/// Steps down before the shank counts as endless.
const STEPS: usize = 40;
/// What an objective leaves open of a tip found by a jog: shares of the picture's shorter side.
const LEFT_SHARE: f64 = 0.02;
/// What a focused shank leaves open of the height, depths of field: the lobes of a pipette's focus curve lie 4.5 away at most.
const LOBE_DEPTHS: f64 = 3.0;
/// What a focused tip leaves open, depths of field: a scan takes either lobe of its focus curve.
const LEFT_DEPTHS: f64 = 2.0;
/// How far back along the pipette the tip is looked for, as a share of the shorter side.
const BACK_SHARE: f64 = 0.2;
/// Heights at which the tip is looked for, and from where it was seen its focus: depths of field. Finders see tips 10 from focus.
const SEEN_DEPTHS: f64 = 12.0;
const FOCUS_DEPTHS: f64 = 20.0;
/// What was found is the pipette's tip when the jog shows it there, as a share of the shorter side.
const SAME_SHARE: f64 = 0.05;

impl Hunt<'_, '_> {
    /// From an end that a jog showed to the tip, and corrects the registration by where that is. Through a weak objective the end that can be seen
    /// is all there is of the tip; through the last one it is found itself, in focus, and brought to the picture's middle.
    pub(super) fn closer(&mut self, view: &View, end: Jogged, last: bool) -> Result<Seen, ProcedureError> {
        let tip = self.down(view, end)?;
        if last { self.tip_at(view, tip) } else { self.end_at(view, tip) }
    }

    /// Goes down along the pipette from an end that was seen, until the end stays where it is: what a jog shows ends where blur hides it, so the end
    /// of a shank's sharp part goes on as the focus does, and a tip does not. Gives the end's offset from the tip's likeliest place.
    fn down(&mut self, view: &View, end: Jogged) -> Result<Vector3<f64>, ProcedureError> {
        let direction = self.direction()?.coordinates;
        let (plan, drop) = (direction.xy().norm(), direction.z.abs());
        let longest = DOWN_SHARE * view.side_um / plan.max(1e-6);
        let step = longest.min(DOWN_DEPTHS * view.depth_um / drop.max(1e-6));
        let mut ends = vec![self.offset(view, end.at())?];
        for _ in 0..STEPS {
            let last = ends[ends.len() - 1];
            self.go(view, last + direction * step, 0.0)?;
            let Some(end) = self.jog(view)? else { return Ok(last) };
            let offset = self.offset(view, end.at())?;
            ends.push(offset);
            if let (Jogged::Tip(_), [.., before, _, _]) = (end, ends.as_slice()) {
                let went = (offset - before).xy().dot(&direction.xy()) / plan.max(1e-6);
                if went < STAYS * 2.0 * step * plan {
                    return Ok((before + offset) / 2.0);
                }
            }
        }
        Err(NotFound::Unseen(Subject::Tip(self.number)).into())
    }

    /// How far what a frame shows at a pixel is from the tip's likeliest place, if it is in focus.
    fn offset(&mut self, view: &View, at: FramePixel) -> Result<Vector3<f64>, ProcedureError> {
        let position = self.live.microscope()?;
        let place = view.chain.pixel_to_ref(position, self.live.window().to_sensor(at));
        Ok(place.coordinates - self.expected()?.coordinates)
    }

    /// Through a weak objective: the place in the picture counts; the height too when markers knew it less well than a focused shank does.
    fn end_at(&mut self, view: &View, tip: Vector3<f64>) -> Result<Seen, ProcedureError> {
        self.correct(Vector3::new(tip.x, tip.y, 0.0));
        self.belief.error.x = LEFT_SHARE * view.side_um;
        self.belief.error.y = self.belief.error.x;
        self.assume();
        self.go(view, Vector3::zeros(), 0.0)?;
        let left = LOBE_DEPTHS * view.depth_um;
        let focuses = self.belief.error.z > left;
        if focuses {
            self.focus(view.middle, SIGMAS * self.belief.error.z)?;
        }
        let subject = Subject::Tip(self.number);
        let Some(Jogged::Tip(at)) = self.jog(view)? else { return Err(NotFound::Unseen(subject).into()) };
        let found = Found { at, confidence: 0.5, angle_deg: None, by: Witness::Detector };
        let mut by = self.offset(view, at)?;
        if focuses {
            self.belief.error.z = left;
        } else {
            by.z = 0.0;
        }
        self.correct(by);
        self.assume();
        Ok(Seen { pixel: self.live.window().to_sensor(at), found })
    }

    /// Through the last objective: the tip itself, in focus, and in the picture's middle.
    fn tip_at(&mut self, view: &View, tip: Vector3<f64>) -> Result<Seen, ProcedureError> {
        let subject = Subject::Tip(self.number);
        self.correct(tip);
        self.assume();
        let seen = self.in_focus(view, &subject)?;
        self.settle(view, &seen)?;
        self.belief.error = Vector3::repeat(LEFT_DEPTHS * view.depth_um);
        self.assume();
        // To the middle, where it is seen once more.
        self.go(view, Vector3::zeros(), 0.0)?;
        let seen = self.live.find(self.finder, &subject, Some(view.middle), Some(SAME_SHARE * view.side_px))?;
        self.settle(view, &seen)?;
        Ok(seen)
    }

    /// Corrects the registration by where the tip is seen, in focus.
    fn settle(&mut self, view: &View, seen: &Seen) -> Result<(), ProcedureError> {
        let by = self.offset(view, seen.found.at)?;
        self.correct(by);
        Ok(())
    }

    /// Looks for the tip itself at one height after the other. What a jog shows ends up to a blur's radius beyond a tip that is far out of
    /// focus: the picture's middle goes back along the pipette for that.
    fn in_focus(&mut self, view: &View, subject: &Subject) -> Result<Seen, ProcedureError> {
        let z = AxisName { device: Device::Scope, coordinate: Coordinate::Z };
        let back = self.direction()?.coordinates.xy() * (-BACK_SHARE * view.side_um);
        self.go(view, Vector3::new(back.x, back.y, 0.0), 0.0)?;
        let (position, tip) = (self.live.microscope()?, self.expected()?);
        let towards = view.towards(position, tip, self.direction()?);
        self.live.expect_angle(towards.y.atan2(towards.x).to_degrees());
        let first = self.live.pose()?.axis(z).0;
        let mut why = None;
        for height in outwards(VISIBLE_DEPTHS * view.depth_um, SEEN_DEPTHS * view.depth_um) {
            let seen = self.live.move_to(&[(z, Micrometres(first + height))]).and_then(|()| self.here(view, subject));
            match seen {
                Ok(seen) => return Ok(seen),
                Err(error) if error.is_local() => why = Some(error),
                Err(error) => return Err(error),
            }
        }
        Err(why.unwrap_or(ProcedureError::NotFound(NotFound::Unseen(subject.clone()))))
    }

    /// Finds the tip at this height, focuses on it, and sees by another jog that it is this pipette's.
    fn here(&mut self, view: &View, subject: &Subject) -> Result<Seen, ProcedureError> {
        let rough = self.live.find(self.finder, subject, None, None)?.pixel;
        let seen = self.live.focus_on(self.finder, subject, Some(rough), FOCUS_DEPTHS * view.depth_um)?;
        let at = self.live.window().to_frame(seen.pixel);
        match self.jog(view)? {
            Some(Jogged::Tip(jogged)) if jogged.distance_px(at) < SAME_SHARE * view.side_px => Ok(seen),
            _ => Err(NotFound::Unseen(subject.clone()).into()),
        }
    }

    /// Focuses on the middle; where the microscope's range ends before the focus does, the pipette comes towards it, from below first.
    fn focus(&mut self, at: Pixel, reach: f64) -> Result<(), ProcedureError> {
        let z = AxisName { device: Device::Scope, coordinate: Coordinate::Z };
        let mut why = None;
        for lift in [0.0, reach, -2.0 * reach] {
            if lift != 0.0 {
                let home = self.live.pose()?.joints(self.number);
                let lifted = self.belief.arm.joints_for(self.belief.arm.tip(home) + Displacement::new(0.0, 0.0, lift));
                self.live.move_to(&targets(Device::Manipulator(self.number), lifted.coordinates))?;
            }
            let here = self.live.pose()?.axis(z);
            match self.live.focus(z, at, (Micrometres(here.0 - reach), Micrometres(here.0 + reach))) {
                Ok(_) => return Ok(()),
                Err(error @ ProcedureError::NotFocused { .. }) => why = Some(error),
                Err(error) => return Err(error),
            }
        }
        Err(why.unwrap_or(ProcedureError::NotFound(NotFound::Unseen(Subject::Tip(self.number)))))
    }
}
