//! A tip brought into view by what the printed markers say of it, with nobody at the microscope.
//!
//! The coarse registration is wrong by a few tenths of a millimetre: more than a 40x objective shows. So the weakest objective looks first, in
//! a spiral and at several heights that cover three standard deviations and no more. The pipette is found by moving it
//! ([`super::jog`]), which works far out of focus, and then focused. Each objective hands a better registration to the next; the last
//! one sees the tip itself. Obstacles are kept clear of by what the registration may still be wrong.

mod view;

use super::camera::sample;
use super::error::ProcedureError;
use super::guard::{Targets, moves_sample, targets};
use super::jog::{Jogged, jogged};
use super::live::{LiveRig, Progress, Seen};
use super::point::{Found, NotFound, PointFinder, Subject, Witness};
use super::record::{Recorder, Sample};
use super::spiral::{outwards, spiral};
use crate::calibration::chain::{Arm, ChainError, Pixel};
use crate::calibration::frames::{Displacement, Man, Point, Ref};
use crate::rig::{AxisName, Coordinate, Device, ManipulatorNumber};
use nalgebra::{Vector2, Vector3};
use parfocal_protocol::units::Micrometres;
use view::View;

/// What to do.
#[derive(Clone, Debug)]
pub struct IntoViewPlan {
    /// Whose tip.
    pub manipulator: ManipulatorNumber,
    /// Objectives from the weakest to the one whose picture the tip is to be in.
    pub objectives: Vec<String>,
}

/// Where the tip was found.
#[derive(Clone, Debug)]
pub struct InView {
    /// The coarse registration, moved to where the tip is.
    pub arm: Arm,
    /// By how much it was moved, in ref.
    pub correction: Displacement<Ref>,
    /// What it may still be wrong, µm.
    pub error_um: f64,
    /// The tip in the picture of the last objective.
    pub seen: Seen,
}

/// Standard deviations that are searched.
const SIGMAS: f64 = 3.0;
/// A jogged pipette is told from its background this many depths of field from focus.
const VISIBLE_DEPTHS: f64 = 15.0;
/// Neighbouring places of the spiral overlap by the rest of this share of the picture.
const SPIRAL_SHARE: f64 = 0.6;
/// A jog, as a share of the picture's shorter side, and at least this many µm.
const JOG_SHARE: f64 = 0.06;
const JOG_LEAST_UM: f64 = 3.0;
/// What an objective leaves open of a tip found by a jog: depths of field, and shares of the picture's shorter side.
const LEFT_DEPTHS: f64 = 1.0;
const LEFT_SHARE: f64 = 0.02;
/// How far back along the pipette the tip is looked for, as a share of the shorter side.
const BACK_SHARE: f64 = 0.2;
/// Heights at which the tip is looked for, and from where it was seen its focus: depths of field. Finders see tips 10 from focus.
const SEEN_DEPTHS: f64 = 12.0;
const FOCUS_DEPTHS: f64 = 20.0;
/// What was found is the pipette's tip when the jog shows it there, as a share of the shorter side.
const SAME_SHARE: f64 = 0.05;
/// More looks than this are no search but an hour lost: a weaker objective needs few.
const LOOKS: usize = 300;
/// Heights that the pipette is lifted by when an obstacle is in the way, and how often.
const LIFTS: usize = 12;

/// Brings the tip into the picture's middle, in focus, through the last of the objectives, and records it there. `change` puts an
/// objective into the light path.
///
/// # Errors
/// [`ProcedureError::Uncoarse`] without a coarse registration, [`NotFound`] when the search ends without the tip, an obstacle or a
/// limit in the way of all of it. The pipette is then back where it was, if that way is free.
pub fn into_view(
    live: &mut LiveRig<'_>,
    finder: &mut dyn PointFinder,
    plan: &IntoViewPlan,
    change: &mut dyn FnMut(&str) -> Result<(), String>,
    recorder: &mut Recorder,
) -> Result<InView, ProcedureError> {
    let number = plan.manipulator;
    let coarse = live.rig().contents().manipulators.get(&number).and_then(|m| m.coarse.as_ref());
    let (arm, error_um) = Arm::coarse_of(live.rig(), number).ok_or(ProcedureError::Uncoarse(number))?;
    let angle = coarse.map_or(0.0, |c| c.error_deg).to_radians();
    let seen_at: Point<Man> = coarse.map_or(Vector3::zeros(), |c| Vector3::from(c.joints_um)).into();
    let device = Device::Manipulator(number);
    live.guard.trusted(&[device, Device::Scope])?;
    let start = live.pose()?;
    // Directions are coarse too: the error grows with the way from where the markers were seen.
    let grown = error_um.hypot(angle * (start.joints(number) - seen_at).coordinates.norm());
    let error = Vector3::new(grown, grown, grown);
    let mut hunt = Hunt { live, finder, number, arm, error, correction: Vector3::zeros() };
    let found = hunt.through(&plan.objectives, change);
    let Hunt { live, arm, error, correction, .. } = hunt;
    match found {
        Ok(seen) => {
            let pose = live.pose()?;
            let mic_um = pose.microscope(live.rig());
            let man_um = Some((number, pose.joints(number).coordinates));
            recorder.keep(Sample { man_um, ..sample(live, &Subject::Tip(number), &pose, &seen, mic_um) })?;
            Ok(InView { arm, correction: correction.into(), error_um: error.max(), seen })
        }
        Err(why) => {
            if live.guard.keep_on() {
                // Best effort: what ended the search is what the person has to know.
                let _ = live.move_to(&targets(device, start.device(device)));
            }
            Err(why)
        }
    }
}

struct Hunt<'h, 'a> {
    live: &'h mut LiveRig<'a>,
    finder: &'h mut dyn PointFinder,
    number: ManipulatorNumber,
    arm: Arm,
    /// Standard deviation of the tip's place along ref's axes, µm.
    error: Vector3<f64>,
    correction: Vector3<f64>,
}

impl Hunt<'_, '_> {
    fn through(
        &mut self,
        objectives: &[String],
        change: &mut dyn FnMut(&str) -> Result<(), String>,
    ) -> Result<Seen, ProcedureError> {
        let mut seen = None;
        for (k, name) in objectives.iter().enumerate() {
            self.assume();
            change(name).map_err(ProcedureError::NotChanged)?;
            self.live.guard.set_objective(name);
            let view = View::of(self.live.rig(), self.live.window(), name)?;
            self.live.tell(Progress::Begins(format!("Looking for the tip of {} through {name}.", self.number)));
            let at = self.search(&view)?;
            let last = k + 1 == objectives.len();
            seen = Some(self.closer(&view, at, last)?);
        }
        seen.ok_or(ProcedureError::NotFound(NotFound::Unseen(Subject::Tip(self.number))))
    }

    fn assume(&mut self) {
        self.live.guard.assume_within(self.number, self.arm, SIGMAS * self.error.max());
    }

    /// Where the tip should be now.
    fn expected(&mut self) -> Result<Point<Ref>, ProcedureError> {
        let joints = self.live.pose()?.joints(self.number);
        Ok(self.arm.tip(joints))
    }

    /// Looks in a spiral, height after height, from the likeliest place outwards. Gives the pixel where the tip was.
    fn search(&mut self, view: &View) -> Result<Pixel, ProcedureError> {
        let heights = outwards(SIGMAS * self.error.z, 2.0 * VISIBLE_DEPTHS * view.depth_um);
        let places = spiral(SIGMAS * self.error.x.max(self.error.y), SPIRAL_SHARE * view.side_um);
        let looks = heights.len() * places.len();
        if looks > LOOKS {
            let objective = self.live.guard.objective().unwrap_or_default().into();
            return Err(ProcedureError::SmallField { objective, looks, error_um: self.error.max() });
        }
        self.lift(view)?;
        let mut why = None;
        for &height in &heights {
            for &[x, y] in &places {
                match self.look(view, Vector3::new(x, y, height)) {
                    Ok(Some(pixel)) => return Ok(pixel),
                    Ok(None) => {}
                    Err(error) if error.is_local() => {
                        self.live.tell(Progress::Passed(error.to_string()));
                        why = Some(error);
                    }
                    Err(error) => return Err(error),
                }
            }
        }
        Err(why.unwrap_or(ProcedureError::NotFound(NotFound::Unseen(Subject::Tip(self.number)))))
    }

    /// Lifts pipette and focus until the obstacles are clear of all places where the tip may be.
    fn lift(&mut self, view: &View) -> Result<(), ProcedureError> {
        let step = self.error.z.max(view.depth_um);
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
    fn go(&mut self, view: &View, offset: Vector3<f64>, lift_um: f64) -> Result<(), ProcedureError> {
        let pose = self.live.pose()?;
        let rig = self.live.rig();
        let tip = self.arm.tip(pose.joints(self.number)).coordinates + Vector3::z() * lift_um;
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
            let room = (SIGMAS * self.error[k]).min((high - low) / 2.0);
            let wanted = base[k].clamp(low + room, high - room) + offset[k];
            let to = wanted.clamp(low, high);
            rest[k] = base[k] + offset[k] - to;
            scope.push((name, Micrometres(to)));
        }
        let joints = self.arm.joints_for(Point::from(tip - rest)).coordinates;
        let mut all = targets(Device::Manipulator(self.number), joints);
        all.append(&mut scope);
        self.live.move_to(&all)
    }

    /// Looks at one place: two frames, the pipette jogged sideways and back.
    fn look(&mut self, view: &View, offset: Vector3<f64>) -> Result<Option<Pixel>, ProcedureError> {
        self.go(view, offset, 0.0)?;
        Ok(match self.jog(view)? {
            Some(Jogged::Tip(at)) => Some(self.live.window().to_sensor(at)),
            // The spiral comes to where the tip is.
            Some(Jogged::Beyond(_)) | None => None,
        })
    }

    /// Jogs the pipette sideways, takes a frame, jogs it back and takes another.
    fn jog(&mut self, view: &View) -> Result<Option<Jogged>, ProcedureError> {
        let pose = self.live.pose()?;
        let home = pose.joints(self.number);
        let along = self.direction()?.coordinates.xy();
        let across = Vector2::new(-along.y, along.x).try_normalize(1e-6).unwrap_or(Vector2::x());
        let by = across * (JOG_SHARE * view.side_um).max(JOG_LEAST_UM);
        let by = Displacement::new(by.x, by.y, 0.0);
        let tip = self.arm.tip(home);
        let aside = self.arm.joints_for(tip + by);
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

    /// Brings the tip seen at a pixel to the middle and into focus, and corrects the registration by where it is.
    fn closer(&mut self, view: &View, at: Pixel, last: bool) -> Result<Seen, ProcedureError> {
        let subject = Subject::Tip(self.number);
        let expected = self.expected()?;
        let position = self.live.microscope()?;
        // Its height is not known yet.
        let mut place = view.chain.pixel_to_ref(position, at).coordinates;
        place.z = expected.coordinates.z;
        self.correct(place - expected.coordinates);
        self.error.x = LEFT_SHARE * view.side_um;
        self.error.y = self.error.x;
        self.assume();
        self.go(view, Vector3::zeros(), 0.0)?;
        let reach = (SIGMAS * self.error.z).max(4.0 * view.depth_um);
        let seen = if last {
            self.in_focus(view, &subject, reach)?
        } else {
            self.focus(view.middle, reach)?;
            let Some(Jogged::Tip(at)) = self.jog(view)? else { return Err(NotFound::Unseen(subject).into()) };
            let found = Found { at, confidence: 0.5, angle_deg: None, by: Witness::Detector };
            Seen { pixel: self.live.window().to_sensor(at), found }
        };
        self.settle(view, &seen)?;
        self.error.z = LEFT_DEPTHS * view.depth_um;
        if !last {
            self.assume();
            return Ok(seen);
        }
        self.error = Vector3::repeat(LEFT_DEPTHS * view.depth_um);
        self.assume();
        // To the middle, where it is seen once more.
        self.go(view, Vector3::zeros(), 0.0)?;
        let seen = self.live.find(self.finder, &subject, Some(view.middle), Some(SAME_SHARE * view.side_px))?;
        self.settle(view, &seen)?;
        Ok(seen)
    }

    /// Corrects the registration by where the tip is seen, in focus.
    fn settle(&mut self, view: &View, seen: &Seen) -> Result<(), ProcedureError> {
        let position = self.live.microscope()?;
        let place = view.chain.pixel_to_ref(position, seen.pixel).coordinates;
        let expected = self.expected()?;
        self.correct(place - expected.coordinates);
        Ok(())
    }

    /// Looks for the tip itself at one height after the other. What a jog shows ends up to a blur's radius beyond a tip that is far out of
    /// focus: the picture's middle goes back along the pipette for that.
    fn in_focus(&mut self, view: &View, subject: &Subject, reach: f64) -> Result<Seen, ProcedureError> {
        let z = AxisName { device: Device::Scope, coordinate: Coordinate::Z };
        let back = self.direction()?.coordinates.xy() * (-BACK_SHARE * view.side_um);
        self.go(view, Vector3::new(back.x, back.y, 0.0), 0.0)?;
        let (position, tip) = (self.live.microscope()?, self.expected()?);
        let towards = view.towards(position, tip, self.direction()?);
        self.live.expect_angle(towards.y.atan2(towards.x).to_degrees());
        let first = self.live.pose()?.axis(z).0;
        let mut why = None;
        for height in outwards(reach, SEEN_DEPTHS * view.depth_um) {
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

    fn direction(&self) -> Result<Displacement<Ref>, ProcedureError> {
        Ok(self.arm.direction().ok_or(ChainError::NoPipette(self.number))?)
    }

    /// Focuses on the middle; where the microscope's range ends before the focus does, the pipette comes towards it, from below first.
    fn focus(&mut self, at: Pixel, reach: f64) -> Result<(), ProcedureError> {
        let z = AxisName { device: Device::Scope, coordinate: Coordinate::Z };
        let mut why = None;
        for lift in [0.0, reach, -2.0 * reach] {
            if lift != 0.0 {
                let home = self.live.pose()?.joints(self.number);
                let lifted = self.arm.joints_for(self.arm.tip(home) + Displacement::new(0.0, 0.0, lift));
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

    fn correct(&mut self, by: Vector3<f64>) {
        self.correction += by;
        self.arm = self.arm.shifted(Displacement::from(by));
    }
}
