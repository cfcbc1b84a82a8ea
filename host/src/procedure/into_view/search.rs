//! The search: in a spiral and at several heights, wherever three standard deviations reach, until a jog shows the pipette.

use super::view::View;
use super::{Hunt, SIGMAS, VISIBLE_DEPTHS};
use crate::calibration::frames::{Displacement, Point};
use crate::procedure::error::ProcedureError;
use crate::procedure::guard::{Targets, moves_sample, targets};
use crate::procedure::jog::{Jogged, jogged};
use crate::procedure::live::{Progress, Seen};
use crate::procedure::point::{NotFound, Subject};
use crate::procedure::spiral::{outwards, spiral};
use crate::rig::{AxisName, Coordinate, Device};
use nalgebra::{Vector2, Vector3};
use parfocal_protocol::units::Micrometres;

/// Neighbouring places of the spiral overlap by the rest of this share of the picture.
const SPIRAL_SHARE: f64 = 0.6;
/// A jog, as a share of the picture's shorter side, and at least this many µm.
const JOG_SHARE: f64 = 0.06;
const JOG_LEAST_UM: f64 = 3.0;
/// More looks than this are no search but an hour lost: a weaker objective needs few.
const LOOKS: usize = 300;
/// Heights that the pipette is lifted by when an obstacle is in the way, and how often.
const LIFTS: usize = 12;

impl Hunt<'_, '_> {
    /// Looks in a spiral, height after height, from the likeliest place outwards, and where something moves as the pipette does comes closer.
    pub(super) fn search(&mut self, view: &View, last: bool) -> Result<Seen, ProcedureError> {
        let heights = outwards(SIGMAS * self.belief.error.z, 2.0 * VISIBLE_DEPTHS * view.depth_um);
        let places = spiral(SIGMAS * self.belief.error.x.max(self.belief.error.y), SPIRAL_SHARE * view.side_um);
        let looks = heights.len() * places.len();
        if looks > LOOKS {
            let objective = self.live.guard.objective().unwrap_or_default().into();
            return Err(ProcedureError::SmallField { objective, looks, error_um: self.belief.error.max() });
        }
        self.lift(view)?;
        let within_um = SIGMAS * self.belief.error.max();
        let mut why = None;
        for &height in &heights {
            for &[x, y] in &places {
                match self.look(view, Vector3::new(x, y, height), last) {
                    Ok(Some(seen)) => return Ok(seen),
                    Ok(None) => {}
                    Err(error) if error.is_local() => {
                        self.live.tell(Progress::Passed(error.to_string()));
                        why = Some(error);
                    }
                    Err(error) => return Err(error),
                }
            }
        }
        match why {
            // An obstacle, a limit, a focus refused: that is what to see to.
            Some(why) if !matches!(why, ProcedureError::NotFound(_)) => Err(why),
            _ => Err(ProcedureError::Nowhere { number: self.number, within_um }),
        }
    }

    /// Lifts pipette and focus until the obstacles are clear of all places where the tip may be.
    fn lift(&mut self, view: &View) -> Result<(), ProcedureError> {
        let step = self.belief.error.z.max(view.depth_um);
        let mut last = None;
        for k in 0..LIFTS {
            match self.go(view, Vector3::zeros(), k as f64 * step) {
                Ok(()) => return Ok(()),
                Err(error @ ProcedureError::Collision(_)) => last = Some(error),
                Err(error) => return Err(error),
            }
        }
        Err(last.unwrap_or(ProcedureError::NotFound(NotFound::Unseen(Subject::Tip(self.number)))))
    }

    /// Brings what lies `offset` from the tip's likeliest place into the picture's middle, in focus: with the microscope as far as it goes,
    /// with the pipette for the rest. The tip's likeliest place goes up by `lift_um` before.
    pub(super) fn go(&mut self, view: &View, offset: Vector3<f64>, lift_um: f64) -> Result<(), ProcedureError> {
        let pose = self.live.pose()?;
        let rig = self.live.rig();
        let tip = self.belief.arm.tip(pose.joints(self.number)).coordinates + Vector3::z() * lift_um;
        let base = view.chain.position_showing(Point::from(tip), view.middle);
        let now = pose.microscope(rig);
        let mut scope: Targets = Vec::new();
        let mut rest = Vector3::zeros();
        for coordinate in Coordinate::ALL {
            let name = AxisName { device: Device::Scope, coordinate };
            let k = coordinate.index();
            if moves_sample(rig, name) || !self.live.guard.has(name) {
                rest[k] = base[k] + offset[k] - now[k];
                continue;
            }
            let settings = self.live.guard.stage().settings(name)?;
            let (low, high) = (settings.low.micrometres().0, settings.high.micrometres().0);
            // The likeliest place is kept so far from the ends of the axis that the search has room.
            let room = (SIGMAS * self.belief.error[k]).min((high - low) / 2.0);
            let wanted = base[k].clamp(low + room, high - room) + offset[k];
            let to = wanted.clamp(low, high);
            rest[k] = base[k] + offset[k] - to;
            scope.push((name, Micrometres(to)));
        }
        let joints = self.belief.arm.joints_for(Point::from(tip - rest)).coordinates;
        let mut all = targets(Device::Manipulator(self.number), joints);
        all.append(&mut scope);
        self.live.move_to(&all)
    }

    /// Looks at one place. What was believed of the tip stays when nothing is there.
    fn look(&mut self, view: &View, offset: Vector3<f64>, last: bool) -> Result<Option<Seen>, ProcedureError> {
        self.go(view, offset, 0.0)?;
        let Some(end) = self.jog(view)? else { return Ok(None) };
        let believed = self.belief.clone();
        let seen = self.closer(view, end, last);
        if seen.is_err() {
            self.belief = believed;
            self.assume();
        }
        seen.map(Some)
    }

    /// Jogs the pipette sideways, takes a frame, jogs it back and takes another.
    pub(super) fn jog(&mut self, view: &View) -> Result<Option<Jogged>, ProcedureError> {
        let pose = self.live.pose()?;
        let home = pose.joints(self.number);
        let along = self.direction()?.coordinates.xy();
        let across = Vector2::new(-along.y, along.x).try_normalize(1e-6).unwrap_or(Vector2::x());
        let by = across * (JOG_SHARE * view.side_um).max(JOG_LEAST_UM);
        let by = Displacement::new(by.x, by.y, 0.0);
        let tip = self.belief.arm.tip(home);
        let aside = self.belief.arm.joints_for(tip + by);
        let device = Device::Manipulator(self.number);
        self.live.move_to(&targets(device, aside.coordinates))?;
        let away = self.live.fresh_frame()?;
        self.live.move_to(&targets(device, home.coordinates))?;
        let here = self.live.fresh_frame()?;
        let position = self.live.microscope()?;
        let jog_px = view.frame_px(position, tip + by) - view.frame_px(position, tip);
        let towards = view.towards(position, tip, self.direction()?);
        Ok(jogged(&away.picture, &here.picture, jog_px, towards))
    }
}
