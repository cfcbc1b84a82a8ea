//! A manipulator's map to ref: which tip is its own, then that tip in focus at random places.

use super::all::{Plan, Work, live};
use super::camera::{ASTRAY_SHARE, CHOICE, MARGIN_SHARE};
use super::error::AutoError;
use super::eyes::Eyes;
use super::gaze::{Expected, Gaze, focus_axis};
use super::places::{expected_samples, weakest, worst_error};
use super::recognise::recognise;
use super::records::{Opened, Records};
use super::shank::{self, Direction};
use crate::calibration::camera::Options;
use crate::calibration::chain::{Arm, Chain, Pixel};
use crate::calibration::frames::{Displacement, Man, Point, Ref, Transform};
use crate::calibration::registration::{RegistrationFit, fit, places};
use crate::calibration::robust::{Fit, Map, Model, ScalePrior};
use crate::calibration::samples::RegistrationSample;
use crate::procedure::{Draws, LiveRig, ProcedureError, Progress, Purpose, Sample, Seen, Targets, targets};
use crate::rig::{AxisName, Coordinate, Device, ManipulatorNumber, Obstacle, Rig};
use nalgebra::Vector3;
use parfocal_protocol::units::Micrometres;
use std::time::SystemTime;

/// Samples at least, and at most.
const LEAST: usize = 12;
const MOST: usize = 80;
/// A first move of a joint: seen well, and not farther than a blurred tip is.
pub const FIRST_UM: f64 = 8.0;
/// Places are chosen at least this far above a floor: the map in the making is not exact yet.
const ABOVE_FLOOR_UM: f64 = 5.0;

/// While samples are few no place is chosen where their noise counts more than √this times.
const FARTHEST_LEVERAGE: f64 = 20.0;

/// What came of it.
pub struct Found {
    /// The registration.
    pub fit: RegistrationFit,
    /// The pipette's direction, if it is known.
    pub direction: Option<Direction>,
    /// Where the samples are.
    pub samples: String,
}

/// Takes samples until the map is known well enough, then follows the shank.
///
/// # Errors
/// [`AutoError`]; what was recorded until then stays recorded.
pub fn calibrate(
    work: &mut Work<'_>,
    rig: &Rig,
    plan: &Plan,
    manipulator: ManipulatorNumber,
    records: &Records,
) -> Result<Found, AutoError> {
    let chain = Chain::of(rig)?;
    let device = Device::Manipulator(manipulator);
    let (mut live, eyes) = live(work, rig)?;
    for (coordinate, what) in Coordinate::ALL.into_iter().zip(["x", "y", "z"]) {
        if !live.guard.has(AxisName { device, coordinate }) {
            return Err(ProcedureError::NoAxis { device, what }.into());
        }
    }
    live.guard.trusted(&[device, Device::Scope])?;
    let opened = records.open(&manipulator.to_string(), Purpose::Registration)?;
    let samples = opened.earlier.as_ref().map(|table| table.registration()).transpose()?.unwrap_or_default();
    live.tell(Progress::Begins(format!("Manipulator {manipulator}: its tip is looked at in many places.")));
    let start = live.pose()?;
    let mut run = Run { live: &mut live, eyes, plan, manipulator, chain, opened, samples, gaze: None, fit: None };
    let done = run.whole(records);
    let (found, path) = (run.fit, run.opened.recorder.path().map(|path| path.display().to_string()));
    if live.guard.keep_on() {
        let mut back = targets(device, start.device(device));
        back.push((focus_axis(), start.axis(focus_axis())));
        live.move_to(&back)?;
    }
    let (direction, _) = done?;
    let fit = found.ok_or(AutoError::NoTip { reach_um: plan.reach_um })?;
    Ok(Found { fit, direction, samples: path.unwrap_or_else(|| "memory".into()) })
}

struct Run<'r, 'a> {
    live: &'r mut LiveRig<'a>,
    eyes: &'r mut dyn Eyes,
    plan: &'r Plan,
    manipulator: ManipulatorNumber,
    chain: Chain,
    opened: Opened,
    samples: Vec<RegistrationSample>,
    gaze: Option<Gaze>,
    fit: Option<RegistrationFit>,
}

impl Run<'_, '_> {
    fn device(&self) -> Device {
        Device::Manipulator(self.manipulator)
    }

    fn whole(&mut self, records: &Records) -> Result<(Option<Direction>, ()), AutoError> {
        let (tip, gaze) = recognise(self.live, self.eyes, &self.chain, self.manipulator, self.plan)?;
        let rough = self.near(tip.pixel);
        let first = gaze.focus(self.live, self.eyes, rough, self.plan.focus_um)?;
        self.gaze = Some(gaze);
        if !self.samples.is_empty() && !self.is_where_it_was(&first)? {
            self.live.tell(Progress::Warning(format!(
                "the tip of {} is not where the earlier run's samples say: they are left aside",
                self.manipulator
            )));
            self.opened = records.anew(&self.manipulator.to_string(), Purpose::Registration)?;
            self.samples.clear();
        }
        let middle = self.keep(&first)?;
        if self.map().is_none() {
            for coordinate in Coordinate::ALL {
                self.first_move(&first, coordinate)?;
            }
        }
        let mut draws = Draws::new(self.plan.seed ^ u64::from(self.manipulator.get()));
        for _ in 0..CHOICE * self.samples.len() {
            draws.one();
        }
        let mut passed = 0;
        while !self.settled(middle)? {
            if self.samples.len() >= MOST {
                return Err(self.unsettled(middle));
            }
            match self.next(middle, &mut draws) {
                Ok(()) => passed = 0,
                Err(error) if error.is_local() => {
                    passed += 1;
                    self.live.tell(Progress::Passed(error.to_string()));
                    if passed > self.plan.patience {
                        let (what, got) = (self.manipulator.to_string(), self.samples.len());
                        return Err(AutoError::Lost { what, got, passed, last: error.to_string() });
                    }
                }
                Err(error) => return Err(error),
            }
        }
        Ok((self.direction(middle)?, ()))
    }

    fn near(&self, pixel: Pixel) -> Expected {
        Expected { pixel, within_px: ASTRAY_SHARE * self.live.window().side_px() }
    }

    /// Keeps what is seen in focus now; where that is in ref.
    fn keep(&mut self, seen: &Seen) -> Result<Point<Ref>, AutoError> {
        let pose = self.live.pose()?;
        let mic_um = pose.microscope(self.live.rig());
        let place = self.chain.pixel_to_ref(mic_um, seen.pixel);
        let sample = Sample {
            time: SystemTime::now(),
            objective: self.live.guard.objective().map(Into::into),
            zoom: self.live.rig().contents().zoom_in_use.unwrap_or(1.0),
            point: format!("tip of {}", self.manipulator),
            man_um: Some((self.manipulator, pose.joints(self.manipulator).coordinates)),
            mic_um,
            pixel: seen.pixel,
            ref_um: Some(place.coordinates),
            confidence: seen.found.confidence,
            by: seen.found.by,
        };
        self.samples.extend(sample.registration());
        self.opened.recorder.keep(sample)?;
        Ok(place)
    }

    fn sources(&self) -> Vec<Vector3<f64>> {
        self.samples.iter().map(|s| s.man_um).collect()
    }

    /// The registration so far: the robust one, or of all samples while they are few.
    fn map(&self) -> Option<Map<3>> {
        self.so_far().map(|fit| fit.map)
    }

    fn so_far(&self) -> Option<Fit<3>> {
        if let Some(fit) = &self.fit {
            return Some(fit.solution.fit);
        }
        let src = self.sources();
        let dst = places(&self.samples, Some(&self.chain)).ok()?;
        if src.len() < 4 {
            return None;
        }
        let mean = src.iter().sum::<Vector3<f64>>() / src.len() as f64;
        let around: Vec<_> = src.iter().map(|p| p - mean).collect();
        let all: Vec<usize> = (0..src.len()).collect();
        let fit = Model::Affine.fit(&around, &dst, &all)?;
        let linear = fit.map.linear;
        let size: f64 = linear.column_iter().map(|c| c.norm()).product();
        let spans = linear.iter().all(|v| v.is_finite()) && linear.determinant().abs() > 0.02 * size;
        let map = Map { linear, shift: fit.map.shift - linear * mean };
        spans.then(|| Fit { map, centre: fit.centre + mean, ..fit })
    }

    fn arm(&self) -> Option<Arm> {
        let map = self.map()?;
        let transform = Transform::<Man, Ref>::new(map.linear, map.shift)?;
        Some(Arm::new(transform, Displacement::new(0.0, 0.0, 0.0), None))
    }

    fn is_where_it_was(&mut self, first: &Seen) -> Result<bool, AutoError> {
        let Some(map) = self.map() else { return Ok(false) };
        let pose = self.live.pose()?;
        let place = self.chain.pixel_to_ref(pose.microscope(self.live.rig()), first.pixel);
        let expected = map.apply(&pose.joints(self.manipulator).coordinates);
        Ok((place.coordinates - expected).norm() < 8.0)
    }

    /// Moves one joint a little, this way or the other, and looks.
    fn first_move(&mut self, first: &Seen, coordinate: Coordinate) -> Result<(), AutoError> {
        let device = self.device();
        let from = self.live.pose()?;
        let z = (focus_axis(), from.axis(focus_axis()));
        let mut why = None;
        for step in [FIRST_UM, -FIRST_UM] {
            let mut to = from.device(device);
            to[coordinate.index()] += step;
            let looked = self.live.move_to(&targets(device, to)).map_err(AutoError::from).and_then(|()| {
                let gaze = self.gaze.clone().ok_or(AutoError::NoTip { reach_um: self.plan.reach_um })?;
                let near = self.near(first.pixel);
                let rough = gaze.look(self.live, self.eyes, Some(near), true)?;
                gaze.focus(self.live, self.eyes, Expected { pixel: rough.pixel, ..near }, self.plan.focus_um)
            });
            let done = match looked {
                Ok(seen) => self.keep(&seen).map(|_| true),
                Err(error) if error.is_local() => {
                    self.live.tell(Progress::Passed(error.to_string()));
                    why.get_or_insert(error.to_string());
                    Ok(false)
                }
                Err(error) => return Err(error),
            }?;
            let mut back = targets(device, from.device(device));
            back.push(z);
            self.live.move_to(&back)?;
            if done {
                return Ok(());
            }
        }
        let axis = AxisName { device, coordinate };
        let why = format!("{axis}: {}", why.unwrap_or_default());
        Err(ProcedureError::NoRoom { device, why, least_um: FIRST_UM }.into())
    }

    /// The place at shares of picture and depth, about the height of the first one.
    fn place(&self, position: Vector3<f64>, middle: Point<Ref>, pixel: Pixel, depth: f64) -> Point<Ref> {
        let mut place = self.chain.pixel_to_ref(position, pixel);
        place.coordinates.z = middle.coordinates.z + (depth - 0.5) * self.plan.depth_um;
        place
    }

    fn lowest(&self) -> f64 {
        let floors = self.live.rig().contents().obstacles.iter().filter_map(|o| match o {
            Obstacle::Floor { z_um, .. } => Some(*z_um + ABOVE_FLOOR_UM),
            _ => None,
        });
        floors.fold(f64::NEG_INFINITY, f64::max)
    }

    /// One more sample, at a random place or, every other time, where the map is weakest.
    fn next(&mut self, middle: Point<Ref>, draws: &mut Draws) -> Result<(), AutoError> {
        let arm = self.arm().ok_or_else(|| ProcedureError::Implausible {
            what: format!(
                "the joints of {} do not move its tip in three directions: do all three axes move?",
                self.manipulator
            ),
        })?;
        self.live.guard.assume(self.manipulator, arm);
        let window = self.live.window();
        let margin = MARGIN_SHARE * window.side_px();
        let position = self.live.microscope()?;
        let lowest = self.lowest();
        let choice: Vec<(Pixel, Point<Ref>)> = (0..CHOICE)
            .map(|_| {
                let share = draws.one();
                let pixel = share.pixel(&window, margin);
                let mut place = self.place(position, middle, pixel, share.depth);
                // Above the floor, as far as it has to be.
                place.coordinates.z = place.coordinates.z.max(lowest);
                (pixel, place)
            })
            .collect();
        let joints: Vec<_> = choice.iter().map(|(_, place)| arm.joints_for(*place).coordinates).collect();
        let weak = self.fit.as_ref().filter(|_| self.samples.len().is_multiple_of(2));
        let first = weak.and_then(|fit| weakest(&fit.solution, &joints)).unwrap_or(0);
        let mut order: Vec<usize> = std::iter::once(first).chain((0..CHOICE).filter(|k| *k != first)).collect();
        if let (None, Some(fit)) = (&self.fit, self.so_far()) {
            // Not farther than the first few samples can tell: the farthest of those, else the nearest of all.
            let leverage = |k: usize| fit.leverage(&joints[k]);
            let rank = |k: usize| if leverage(k) <= FARTHEST_LEVERAGE { -leverage(k) } else { leverage(k) };
            order.sort_by(|a, b| rank(*a).total_cmp(&rank(*b)));
        }
        // Where there is no room another one does.
        let mut why = None;
        for k in order {
            let (pixel, place) = choice[k];
            let mut to: Targets = targets(self.device(), joints[k]);
            let here = self.live.pose()?.axis(focus_axis());
            let up = place.coordinates.z - self.chain.pixel_to_ref(position, pixel).coordinates.z;
            to.push((focus_axis(), Micrometres(here.0 + up)));
            match self.live.move_to(&to) {
                Ok(()) => {
                    let gaze = self.gaze.clone().ok_or(AutoError::NoTip { reach_um: self.plan.reach_um })?;
                    let near = self.near(pixel);
                    let seen = gaze.focus(self.live, self.eyes, near, self.plan.focus_um)?;
                    self.keep(&seen)?;
                    return Ok(());
                }
                Err(error) if error.is_local() => {
                    why.get_or_insert(error);
                }
                Err(error) => return Err(error.into()),
            }
        }
        Err(why.map_or(AutoError::NoTip { reach_um: self.plan.reach_um }, AutoError::from))
    }

    /// Solves what there is. True when it is known well enough.
    fn settled(&mut self, middle: Point<Ref>) -> Result<bool, AutoError> {
        let n = self.samples.len();
        if n < LEAST {
            self.live.tell(Progress::Recorded { done: n, of: LEAST });
            return Ok(false);
        }
        let options = Options { tolerance_um: None, seed: self.plan.seed, estimator: Default::default() };
        // Few samples may still be ambiguous; more will tell.
        let fit = fit(&self.samples, Some(&self.chain), Model::Affine, Some(ScalePrior::default()), &options);
        self.fit = fit.ok();
        let error = self.error(middle)?;
        let inliers = self.fit.as_ref().map_or(0, |fit| fit.solution.chosen().len());
        let settled = error <= self.plan.error_um && inliers >= LEAST;
        let of = expected_samples(n, error, self.plan.error_um, LEAST, MOST);
        self.live.tell(Progress::Recorded { done: n, of: if settled { n } else { of } });
        Ok(settled)
    }

    /// The standard error at the worst place in view.
    fn error(&mut self, middle: Point<Ref>) -> Result<f64, AutoError> {
        let (Some(fit), Some(arm)) = (&self.fit, self.arm()) else { return Ok(f64::INFINITY) };
        let window = self.live.window();
        let position = self.live.pose()?.microscope(self.live.rig());
        let corners: Vec<_> = (0..8)
            .map(|k| {
                let share = |bit: u32| f64::from((k >> bit) & 1);
                let place = self.place(position, middle, window.at_share(share(0), share(1), 0.0), share(2));
                arm.joints_for(place).coordinates
            })
            .collect();
        Ok(worst_error(&fit.solution, &corners).unwrap_or(f64::INFINITY))
    }

    fn unsettled(&mut self, middle: Point<Ref>) -> AutoError {
        let error_um = self.error(middle).unwrap_or(f64::INFINITY);
        let (what, samples) = (self.manipulator.to_string(), self.samples.len());
        AutoError::Unsettled { what, samples, error_um, asked_um: self.plan.error_um }
    }

    /// Brings the tip to where its shank is in view for long, and follows it.
    fn direction(&mut self, middle: Point<Ref>) -> Result<Option<Direction>, AutoError> {
        let (Some(arm), Some(gaze), Some(fit)) = (self.arm(), self.gaze.clone(), &self.fit) else { return Ok(None) };
        let linear = fit.solution.fit.map.linear;
        self.live.guard.assume(self.manipulator, arm);
        let window = self.live.window();
        let position = self.live.microscope()?;
        let pixel = window.at_share(0.5, 0.5, 0.0);
        let place = self.place(position, middle, pixel, 0.5);
        let here = self.live.pose()?.axis(focus_axis());
        let up = place.coordinates.z - self.chain.pixel_to_ref(position, pixel).coordinates.z;
        let mut to: Targets = targets(self.device(), arm.joints_for(place).coordinates);
        to.push((focus_axis(), Micrometres(here.0 + up)));
        let looked = self.live.move_to(&to).map_err(AutoError::from).and_then(|()| {
            let near = self.near(pixel);
            let seen = gaze.focus(self.live, self.eyes, near, self.plan.focus_um)?;
            let places = shank::follow(self.live, &self.chain, &seen)?;
            Ok((seen, places))
        });
        match looked {
            Ok((seen, places)) => {
                let azimuth = seen.found.angle_deg.map(|deg| self.azimuth_deg(deg));
                Ok(shank::direction(&places, &linear, azimuth))
            }
            Err(error) if error.is_local() => {
                self.live.tell(Progress::Passed(format!("the shank: {error}")));
                Ok(shank::direction(&[], &linear, gaze.angle_deg.map(|deg| self.azimuth_deg(deg))))
            }
            Err(error) => Err(error),
        }
    }

    /// A direction in the picture as one in ref, seen from above.
    fn azimuth_deg(&self, in_picture_deg: f64) -> f64 {
        let (sin, cos) = in_picture_deg.to_radians().sin_cos();
        let way = self.chain.ref_from_image(Vector3::zeros()) * Displacement::new(cos, sin, 0.0);
        way.coordinates.y.atan2(way.coordinates.x).to_degrees()
    }
}
