//! A manipulator's live registration: its tip in focus at positions drawn uniformly in the picture and in depth.
//!
//! Nothing needs to be known of the manipulator but that its tip is in view, within some µm of focus. A small move of
//! each joint first tells which way it goes; each sample then makes the next prediction better.

use super::camera::sample;
use super::draw::{Draws, Share};
use super::error::ProcedureError;
use super::follow::Follow;
use super::guard::{Targets, targets};
use super::live::{LiveRig, Progress, Seen};
use super::point::{NotFound, PointFinder, Subject};
use super::record::{Recorder, Sample};
use super::survey::{ASTRAY_SHARE, ERROR_SHARE, MARGIN_SHARE, REDRAWS, patience};
use crate::calibration::chain::{Arm, Chain};
use crate::calibration::frames::{Displacement, Man, Point, Ref, Transform};
use crate::rig::{AxisName, Coordinate, Device, ManipulatorNumber};
use nalgebra::Vector3;
use parfocal_protocol::units::Micrometres;

/// What to do.
#[derive(Clone, Debug)]
pub struct RegistrationPlan {
    /// Whose tip.
    pub manipulator: ManipulatorNumber,
    /// Places to see it at, besides four first ones.
    pub places: usize,
    /// Of the draws.
    pub seed: u64,
    /// How far the places spread in depth, µm.
    pub depth_um: f64,
    /// How far from a predicted height the tip's focus may be, µm; at the first moves, from the present one.
    pub focus_within_um: f64,
}

/// First moves go this share of the picture's shorter side…
const FIRST_SHARE: f64 = 0.12;
/// … but not farther than a blurred tip can be found from, µm.
const FIRST_MOST_UM: f64 = 10.0;
/// … nor less than what is told from noise, µm.
const FIRST_LEAST_UM: f64 = 4.0;

/// Foci that err by more do not count while the map is learned, µm.
const FOCUS_ERROR_UM: f64 = 3.0;

/// Where a tip was seen in focus.
struct Sighting {
    joints: Point<Man>,
    place: Point<Ref>,
}

/// Records the samples of a registration; solve them with [`crate::calibration::registration::fit`]. The manipulator and
/// the microscope go back to where they were, whether this succeeds or not.
///
/// # Errors
/// [`ProcedureError`]: the objective is not known, the tip is lost, a joint has no room … What was recorded until then
/// stays recorded.
pub fn registration(
    live: &mut LiveRig<'_>,
    finder: &mut dyn PointFinder,
    plan: &RegistrationPlan,
    recorder: &mut Recorder,
) -> Result<(), ProcedureError> {
    let chain = Chain::of(live.rig())?;
    let device = Device::Manipulator(plan.manipulator);
    for (coordinate, what) in Coordinate::ALL.into_iter().zip(["x", "y", "z"]) {
        if !live.guard.has(AxisName { device, coordinate }) {
            return Err(ProcedureError::NoAxis { device, what });
        }
    }
    if !live.guard.has(focus_axis()) {
        return Err(ProcedureError::NoAxis { device: Device::Scope, what: "z" });
    }
    live.guard.trusted(&[device, Device::Scope])?;
    let start = live.pose()?;
    // As far as the same share of the picture reaches in ref, or as the focus errs.
    let unit = chain.ref_from_image(Vector3::zeros()).linear().column(0).norm();
    let error_um = (ERROR_SHARE * live.window().side_px() * unit).max(FOCUS_ERROR_UM);
    let (follow, subject) = (Follow::new(error_um), Subject::Tip(plan.manipulator));
    let mut run = Run { live, finder, plan, recorder, chain, follow, known: None, subject };
    let done = run.record();
    let live = run.live;
    let returned = if live.guard.keep_on() {
        let mut back = targets(device, start.device(device));
        back.push((focus_axis(), start.axis(focus_axis())));
        live.move_to(&back)
    } else {
        Ok(())
    };
    done.and(returned)
}

fn focus_axis() -> AxisName {
    AxisName { device: Device::Scope, coordinate: Coordinate::Z }
}

struct Run<'r, 'a> {
    live: &'r mut LiveRig<'a>,
    finder: &'r mut dyn PointFinder,
    plan: &'r RegistrationPlan,
    recorder: &'r mut Recorder,
    chain: Chain,
    follow: Follow<3>,
    /// The last plausible map.
    known: Option<Arm>,
    subject: Subject,
}

impl Run<'_, '_> {
    fn device(&self) -> Device {
        Device::Manipulator(self.plan.manipulator)
    }

    fn record(&mut self) -> Result<(), ProcedureError> {
        let total = self.plan.places + 4;
        self.live.tell(Progress::Begins(format!("Looking at {} in {total} places.", self.subject)));
        let first = self.look(None)?;
        self.live.guard.seen(self.plan.manipulator, first.place, first.joints);
        for coordinate in Coordinate::ALL {
            self.first_move(&first, coordinate)?;
        }
        let Some(arm) = self.arm() else {
            return Err(ProcedureError::Implausible {
                what: format!(
                    "the joints of {} do not move its tip in three directions: do all three axes move, and is the tip its own?",
                    self.plan.manipulator
                ),
            });
        };
        self.live.guard.assume(self.plan.manipulator, arm);
        let mut draws = Draws::new(self.plan.seed);
        let mut shares = draws.in_depth(self.plan.places);
        shares.reverse();
        let (mut done, mut passed, mut last) = (0, 0, String::new());
        while done < self.plan.places {
            let share = shares.pop().unwrap_or_else(|| draws.one());
            let sighting = self.approach(&first, share, &mut draws).and_then(|expected| self.look(Some(expected)));
            match sighting {
                Ok(_) => {
                    done += 1;
                    if let Some(arm) = self.arm() {
                        self.live.guard.assume(self.plan.manipulator, arm);
                    }
                }
                Err(error) if error.is_local() => {
                    passed += 1;
                    last = error.to_string();
                    self.live.tell(Progress::Passed(last.clone()));
                }
                Err(error) => return Err(error),
            }
            if passed > patience(self.plan.places) {
                return Err(ProcedureError::Lost { got: done + 4, wanted: total, passed, last });
            }
        }
        Ok(())
    }

    /// The registration so far; the last plausible one when what was seen last makes none.
    fn arm(&mut self) -> Option<Arm> {
        self.known = self.fitted().or(self.known);
        self.known
    }

    fn fitted(&self) -> Option<Arm> {
        let map = self.follow.map()?;
        let size: f64 = map.linear.column_iter().map(|c| c.norm()).product();
        let spans = map.linear.determinant().abs() > 0.02 * size;
        let transform = spans.then(|| Transform::<Man, Ref>::new(map.linear, map.shift)).flatten()?;
        Some(Arm::new(transform, Displacement::new(0.0, 0.0, 0.0), None))
    }

    /// Focuses on the tip, finds it, keeps the sample.
    fn look(&mut self, expected: Option<Point<Ref>>) -> Result<Sighting, ProcedureError> {
        let position = self.live.microscope()?;
        let pixel = expected.map(|p| self.chain.ref_to_pixel(position, p).0);
        let reach = self.plan.focus_within_um;
        let seen: Seen = match pixel {
            None => self.live.first_focus_on(self.finder, &self.subject, reach)?,
            Some(_) => self.live.focus_on(self.finder, &self.subject, pixel, reach)?,
        };
        let pose = self.live.pose()?;
        let mic_um = pose.microscope(self.live.rig());
        let joints = pose.joints(self.plan.manipulator);
        let place = self.chain.pixel_to_ref(mic_um, seen.pixel);
        // Also when it is astray: it may be the map that is.
        self.follow.add(joints.coordinates, place.coordinates);
        if let Some(pixel) = pixel {
            let within = ASTRAY_SHARE * self.live.window().side_px();
            let off = (pixel.x_px - seen.pixel.x_px).hypot(pixel.y_px - seen.pixel.y_px);
            if off > within {
                let (off_px, within_px) = (off.round() as u32, within.round() as u32);
                return Err(NotFound::Elsewhere { subject: self.subject.clone(), off_px, within_px }.into());
            }
        }
        let kept = Sample {
            man_um: Some((self.plan.manipulator, joints.coordinates)),
            ref_um: Some(place.coordinates),
            ..sample(self.live, &self.subject, &pose, &seen, mic_um)
        };
        self.recorder.keep(kept)?;
        let (done, of) = (self.recorder.samples().len(), self.plan.places + 4);
        self.live.tell(Progress::Recorded { done, of });
        Ok(Sighting { joints, place })
    }

    /// Moves one joint a little, this way or the other, and looks.
    fn first_move(&mut self, first: &Sighting, coordinate: Coordinate) -> Result<(), ProcedureError> {
        let unit = self.chain.ref_from_image(Vector3::zeros()).linear().column(0).norm();
        let step = (FIRST_SHARE * self.live.window().side_px() * unit).clamp(FIRST_LEAST_UM, FIRST_MOST_UM);
        let mut why = None;
        for step in [step, -step] {
            let mut to = first.joints.coordinates;
            to[coordinate.index()] += step;
            let looked = self.live.move_to(&targets(self.device(), to)).and_then(|()| self.look(None));
            match looked {
                Ok(_) => return Ok(()),
                Err(error) if error.is_local() => {
                    self.live.tell(Progress::Passed(error.to_string()));
                    why.get_or_insert(error);
                }
                Err(error) => return Err(error),
            }
        }
        let why = why.map_or_else(String::new, |e| e.to_string());
        let axis = AxisName { device: self.device(), coordinate };
        Err(ProcedureError::NoRoom { device: self.device(), why: format!("{axis}: {why}"), least_um: step })
    }

    /// Moves the tip to a drawn place and the focus with it; draws again where there is no room. Says where the tip
    /// should be.
    fn approach(
        &mut self,
        first: &Sighting,
        mut share: Share,
        draws: &mut Draws,
    ) -> Result<Point<Ref>, ProcedureError> {
        let window = self.live.window();
        let margin = MARGIN_SHARE * window.side_px();
        let mut why = None;
        for _ in 0..REDRAWS {
            let mut position = self.live.microscope()?;
            let focus = position.z;
            // The height at which the first place is in focus is the middle of the depth.
            let middle = position.z
                + (first.place.coordinates.z
                    - self.chain.pixel_to_ref(position, share.pixel(&window, margin)).coordinates.z);
            position.z = middle + (share.depth - 0.5) * self.plan.depth_um;
            let place = self.chain.pixel_to_ref(position, share.pixel(&window, margin));
            let Some(arm) = self.arm() else { break };
            let mut to: Targets = targets(self.device(), arm.joints_for(place).coordinates);
            // The stage's z counts in P_M, so the focus follows by as much.
            let here = self.live.pose()?.axis(focus_axis());
            to.push((focus_axis(), Micrometres(here.0 + position.z - focus)));
            match self.live.move_to(&to) {
                Ok(()) => return Ok(place),
                Err(error) if error.is_local() => why = Some(error),
                Err(error) => return Err(error),
            }
            share = draws.one();
        }
        let why = why.map_or_else(String::new, |e| e.to_string());
        Err(ProcedureError::NoRoom { device: self.device(), why, least_um: self.plan.depth_um / 2.0 })
    }
}
