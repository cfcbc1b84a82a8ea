//! A tip brought into view by what the printed markers say of it, with nobody at the microscope.
//!
//! The coarse registration is wrong by a few tenths of a millimetre: more than a 40x objective shows. So the weakest objective looks first, in
//! a spiral and at several heights that cover three standard deviations and no more. The pipette is found by moving it
//! ([`super::jog`]), which works far out of focus, and then focused. Each objective hands a better registration to the next; the last
//! one sees the tip itself. Obstacles are kept clear of by what the registration may still be wrong.

mod closer;
mod search;
mod view;

use super::camera::sample;
use super::error::ProcedureError;
use super::guard::targets;
use super::live::{LiveRig, Progress, Seen};
use super::point::{NotFound, PointFinder, Subject};
use super::record::{Recorder, Sample};
use crate::calibration::chain::{Arm, ChainError};
use crate::calibration::frames::{Displacement, Man, Point, Ref};
use crate::rig::{Device, ManipulatorNumber, Rig};
use nalgebra::Vector3;
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

impl InView {
    /// Puts the moved coarse registration in force in the rig's file.
    ///
    /// # Errors
    /// [`ProcedureError::Uncoarse`] when the file has none any more.
    pub fn put(&self, rig: &mut Rig, number: ManipulatorNumber, date: String) -> Result<(), ProcedureError> {
        let manipulator = rig.contents_mut().manipulators.get_mut(&number);
        let coarse = manipulator.and_then(|m| m.coarse.as_mut()).ok_or(ProcedureError::Uncoarse(number))?;
        coarse.matrix = self.arm.ref_from_man().to_rows();
        coarse.error_um = self.error_um;
        coarse.date = date;
        Ok(())
    }
}

/// Standard deviations that are searched.
const SIGMAS: f64 = 3.0;
/// A jogged pipette is told from its background this many depths of field from focus.
const VISIBLE_DEPTHS: f64 = 15.0;
/// Brings the tip into the picture's middle, in focus, through the last of the objectives, and records it there. `change` puts an
/// objective into the light path.
///
/// # Errors
/// [`ProcedureError::Uncoarse`] without a coarse registration, [`ProcedureError::Nowhere`] when the search ends without the tip, an obstacle or
/// a limit in the way of all of it. The pipette is then back where it was, if that way is free.
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
    let belief = Belief { arm, error, correction: Vector3::zeros() };
    let mut hunt = Hunt { live, finder, number, belief };
    let found = hunt.through(&plan.objectives, change);
    let Hunt { live, belief: Belief { arm, error, correction }, .. } = hunt;
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
    belief: Belief,
}

/// What is believed of the tip.
#[derive(Clone)]
struct Belief {
    arm: Arm,
    /// Standard deviation of the tip's place along ref's axes, µm.
    error: Vector3<f64>,
    /// What the coarse registration was corrected by, µm.
    correction: Vector3<f64>,
}

impl Hunt<'_, '_> {
    fn through(
        &mut self,
        objectives: &[String],
        change: &mut dyn FnMut(&str) -> Result<(), String>,
    ) -> Result<Seen, ProcedureError> {
        let mut seen = Err(NotFound::Unseen(Subject::Tip(self.number)).into());
        for (k, name) in objectives.iter().enumerate() {
            self.assume();
            change(name).map_err(ProcedureError::NotChanged)?;
            self.live.guard.set_objective(name);
            let view = View::of(self.live.rig(), self.live.window(), name)?;
            self.live.tell(Progress::Begins(format!("Looking for the tip of {} through {name}.", self.number)));
            seen = Ok(self.search(&view, k + 1 == objectives.len())?);
        }
        seen
    }

    fn assume(&mut self) {
        self.live.guard.assume_within(self.number, self.belief.arm, SIGMAS * self.belief.error.max());
    }

    /// Where the tip should be now.
    fn expected(&mut self) -> Result<Point<Ref>, ProcedureError> {
        let joints = self.live.pose()?.joints(self.number);
        Ok(self.belief.arm.tip(joints))
    }

    fn direction(&self) -> Result<Displacement<Ref>, ProcedureError> {
        Ok(self.belief.arm.direction().ok_or(ChainError::NoPipette(self.number))?)
    }

    fn correct(&mut self, by: Vector3<f64>) {
        self.belief.correction += by;
        self.belief.arm = self.belief.arm.shifted(Displacement::from(by));
    }
}
