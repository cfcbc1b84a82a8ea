//! The camera's matrix from a tip that stays while the microscope moves.

use super::all::{Plan, Work, live};
use super::error::AutoError;
use super::gaze::{Expected, FOCUSED_PX, Gaze, apart, focus_on_one};
use super::places::{expected_samples, weakest, worst_error};
use super::records::{Opened, Records};
use crate::calibration::camera::{CameraFit, Options, fit};
use crate::calibration::chain::Pixel;
use crate::calibration::robust::{Map, Model};
use crate::calibration::samples::CameraSample;
use crate::procedure::{Draws, LiveRig, Progress, Purpose, Sample, Seen, Subject, what_moves};
use crate::rig::{AxisName, Coordinate, Device, Moves, Rig};
use nalgebra::Vector2;
use parfocal_protocol::units::Micrometres;
use std::time::SystemTime;

/// Samples at least, and at most.
const LEAST: usize = 8;
const MOST: usize = 60;
/// The very first move, µm: little enough for any objective; and the farthest.
const FIRST_UM: f64 = 2.0;
const FARTHEST_UM: f64 = 600.0;
/// The first moves shift the picture by about this share of its shorter side.
const FIRST_SHARE: f64 = 0.12;
/// The tip stays this share of the shorter side away from the picture's edge.
pub const MARGIN_SHARE: f64 = 0.1;
/// A tip farther than this share of the shorter side from where it should be is another one.
pub const ASTRAY_SHARE: f64 = 0.1;
/// Places among which the most telling is chosen.
pub const CHOICE: usize = 12;

/// Tips that may turn out to be none, one after another.
const UNFIT: usize = 4;

/// What came of it.
pub struct Found {
    /// The matrix.
    pub fit: CameraFit,
    /// Where the samples are.
    pub samples: String,
}

/// Takes samples until the matrix is known well enough.
///
/// # Errors
/// [`AutoError`]; what was recorded until then stays recorded.
pub fn calibrate(work: &mut Work<'_>, rig: &Rig, plan: &Plan, records: &Records) -> Result<Found, AutoError> {
    if what_moves(rig)? == Moves::Stage {
        return Err(crate::procedure::ProcedureError::Implausible {
            what: "the stage moves the sample, not the tips: calibrate the camera first, with a point on the sample ('parfocal calibrate camera')".into(),
        }
        .into());
    }
    let opened = records.open("camera", Purpose::Microscope)?;
    let samples = opened.earlier.as_ref().map(|table| table.camera()).transpose()?.unwrap_or_default();
    let (mut live, eyes) = live(work, rig)?;
    live.tell(Progress::Begins("Camera: a tip is looked at from many places of the microscope.".into()));
    let place = Place { plan, opened, samples, gaze: None };
    let start = live.pose()?;
    let mut run = Run { live: &mut live, eyes, place, fit: None };
    let done = run.whole(records);
    let samples = run.place.opened.recorder.path().map_or("memory".into(), |path| path.display().to_string());
    let found = run.fit;
    if live.guard.keep_on() {
        let back = [Coordinate::X, Coordinate::Y].map(|coordinate| {
            let axis = AxisName { device: Device::Scope, coordinate };
            (axis, start.axis(axis))
        });
        live.move_to(&back)?;
    }
    done?;
    found.map(|fit| Found { fit, samples }).ok_or(AutoError::NoTip { reach_um: plan.reach_um })
}

struct Place<'p> {
    plan: &'p Plan,
    opened: Opened,
    samples: Vec<CameraSample>,
    gaze: Option<Gaze>,
}

struct Run<'r, 'a> {
    live: &'r mut LiveRig<'a>,
    eyes: &'r mut dyn super::Eyes,
    place: Place<'r>,
    fit: Option<CameraFit>,
}

impl Run<'_, '_> {
    fn whole(&mut self, records: &Records) -> Result<(), AutoError> {
        if self.settled()? {
            return Ok(());
        }
        self.begin(records)?;
        let mut draws = Draws::new(self.place.plan.seed);
        // Draws that an earlier run has used up.
        for _ in 0..CHOICE * self.place.samples.len() {
            draws.one();
        }
        let mut passed = 0;
        while !self.settled()? {
            if self.place.samples.len() >= MOST {
                return Err(self.unsettled());
            }
            match self.next(&mut draws) {
                Ok(()) => passed = 0,
                Err(error) if error.is_local() => {
                    passed += 1;
                    self.live.tell(Progress::Passed(error.to_string()));
                    if passed > self.place.plan.patience {
                        let (what, got) = ("the camera".into(), self.place.samples.len());
                        return Err(AutoError::Lost { what, got, passed, last: error.to_string() });
                    }
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Finds a tip that can be focused and moves in the picture when the microscope does.
    fn begin(&mut self, records: &Records) -> Result<(), AutoError> {
        let (start, mut unfit) = (self.xy()?, Vec::new());
        loop {
            let first = self.first_look(&unfit).map_err(|error| match (error, unfit.pop()) {
                (AutoError::NoTip { .. }, Some((_, why))) => why,
                (error, _) => error,
            })?;
            let why = match self.first_moves(&first, records) {
                Ok(()) => return Ok(()),
                Err(error) if unfit.len() < UNFIT && error.is_of_one_tip() => error,
                Err(error) => return Err(error),
            };
            self.live.tell(Progress::Passed(why.to_string()));
            unfit.push((first.pixel, why));
            self.move_xy(start)?;
            self.anew(records)?;
        }
    }

    /// The first tip's sample, and one from a little aside on each axis.
    fn first_moves(&mut self, first: &Seen, records: &Records) -> Result<(), AutoError> {
        if !self.place.samples.is_empty() && !self.is_where_it_was(first)? {
            self.live.tell(Progress::Warning(
                "the tip is not where the earlier run left it: its samples of the camera are left aside".into(),
            ));
            self.anew(records)?;
        }
        if self.place.samples.is_empty() {
            self.keep(first)?;
        }
        let at = self.xy()?;
        for coordinate in [Coordinate::X, Coordinate::Y] {
            if self.map().is_none() {
                self.first_move(at, first.pixel, coordinate)?;
            }
        }
        Ok(())
    }

    fn anew(&mut self, records: &Records) -> Result<(), AutoError> {
        self.place.opened = records.anew("camera", Purpose::Microscope)?;
        self.place.samples.clear();
        Ok(())
    }

    /// Finds a tip that is not one of the unfit ones, brings it into focus, remembers what it looks like.
    fn first_look(&mut self, unfit: &[(Pixel, AutoError)]) -> Result<Seen, AutoError> {
        let fit = |_: &mut LiveRig<'_>, mut tips: Vec<Seen>| {
            tips.retain(|tip| !unfit.iter().any(|(pixel, _)| apart(*pixel, tip.pixel) <= FOCUSED_PX));
            tips
        };
        let subject = Subject::Point("a tip".into());
        let (gaze, seen) = focus_on_one(self.live, self.eyes, self.place.plan, &subject, &fit)?;
        self.place.gaze = Some(gaze);
        Ok(seen)
    }

    fn look(&mut self, expected: Option<Expected>) -> Result<Seen, AutoError> {
        let gaze = self.place.gaze.clone().ok_or(AutoError::NoTip { reach_um: self.place.plan.reach_um })?;
        gaze.look(self.live, self.eyes, expected, false)
    }

    fn xy(&mut self) -> Result<Vector2<f64>, AutoError> {
        Ok(self.live.pose()?.device(Device::Scope).xy())
    }

    fn move_xy(&mut self, at: Vector2<f64>) -> Result<(), AutoError> {
        let axis = |coordinate| AxisName { device: Device::Scope, coordinate };
        let to = [(axis(Coordinate::X), Micrometres(at.x)), (axis(Coordinate::Y), Micrometres(at.y))];
        Ok(self.live.move_to(&to)?)
    }

    fn keep(&mut self, seen: &Seen) -> Result<(), AutoError> {
        let mic_um = self.live.pose()?.device(Device::Scope);
        let sample = Sample {
            time: SystemTime::now(),
            objective: self.live.guard.objective().map(Into::into),
            zoom: self.live.rig().contents().zoom_in_use.unwrap_or(1.0),
            point: "tip".into(),
            man_um: None,
            mic_um,
            pixel: seen.pixel,
            ref_um: None,
            confidence: seen.found.confidence,
            by: seen.found.by,
        };
        self.place.samples.push(sample.camera());
        self.place.opened.recorder.keep(sample)?;
        Ok(())
    }

    /// From the picture (px from the sensor's middle) to the microscope; `None` while the samples do not span it.
    fn map(&self) -> Option<Map<2>> {
        if let Some(fit) = &self.fit {
            return Some(fit.solution.fit.map);
        }
        let src: Vec<_> = self.place.samples.iter().map(|s| self.centred(s.pixel)).collect();
        let dst: Vec<_> = self.place.samples.iter().map(|s| s.mic_um).collect();
        if src.len() < 3 {
            return None;
        }
        let mean = src.iter().sum::<Vector2<f64>>() / src.len() as f64;
        let around: Vec<_> = src.iter().map(|p| p - mean).collect();
        let all: Vec<usize> = (0..src.len()).collect();
        let map = Model::Affine.fit(&around, &dst, &all)?.map;
        let size = map.linear.column(0).norm() * map.linear.column(1).norm();
        let spans = map.linear.iter().all(|v| v.is_finite()) && map.linear.determinant().abs() > 0.2 * size;
        spans.then(|| Map { linear: map.linear, shift: map.shift - map.linear * mean })
    }

    fn centred(&self, pixel: Pixel) -> Vector2<f64> {
        self.live.window().sensor().to_image(pixel).coordinates.xy()
    }

    fn is_where_it_was(&mut self, first: &Seen) -> Result<bool, AutoError> {
        let Some(map) = self.map() else { return Ok(false) };
        let by = map.apply(&self.centred(first.pixel)) - self.xy()?;
        let inverse = map.linear.try_inverse().unwrap_or_else(nalgebra::Matrix2::zeros);
        Ok((inverse * by).norm() < 10.0)
    }

    /// Solves what there is. True when it is known well enough.
    fn settled(&mut self) -> Result<bool, AutoError> {
        let n = self.place.samples.len();
        if n < LEAST {
            return Ok(false);
        }
        let plan = self.place.plan;
        let options = Options { tolerance_um: None, seed: plan.seed, estimator: Default::default() };
        // Few samples may still be ambiguous; more will tell.
        self.fit = fit(&self.place.samples, self.live.window().sensor(), Moves::Objective, &options).ok();
        let Some(fit) = &self.fit else { return Ok(false) };
        let error = worst_error(&fit.solution, &self.corners()).unwrap_or(f64::INFINITY);
        let inliers = fit.solution.chosen().len();
        let of = expected_samples(n, error, plan.camera_error_um(), LEAST, MOST);
        let settled = error <= plan.camera_error_um() && inliers >= LEAST;
        self.live.tell(Progress::Recorded { done: n, of: if settled { n } else { of } });
        Ok(settled)
    }

    fn unsettled(&self) -> AutoError {
        let error = self.fit.as_ref().and_then(|fit| worst_error(&fit.solution, &self.corners()));
        AutoError::Unsettled {
            what: "the camera".into(),
            samples: self.place.samples.len(),
            error_um: error.unwrap_or(f64::INFINITY),
            asked_um: self.place.plan.camera_error_um(),
        }
    }

    fn corners(&self) -> Vec<Vector2<f64>> {
        let window = self.live.window();
        [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(x, y)| self.centred(window.at_share(x, y, 0.0))).into()
    }

    /// Moves one axis, very little first, until the picture has shifted well.
    fn first_move(&mut self, at: Vector2<f64>, from: Pixel, coordinate: Coordinate) -> Result<(), AutoError> {
        let wish = FIRST_SHARE * self.live.window().side_px();
        let (mut step, mut turned) = (FIRST_UM, false);
        while step.abs() <= FARTHEST_UM {
            let by = if coordinate == Coordinate::X { Vector2::new(step, 0.0) } else { Vector2::new(0.0, step) };
            let seen = self.move_xy(at + by).and_then(|()| self.look(None));
            match seen {
                Ok(seen) => {
                    let shift = apart(seen.pixel, from);
                    if shift >= 0.6 * wish {
                        return self.keep(&seen);
                    }
                    step *= if shift > 4.0 { (1.1 * wish / shift).clamp(1.2, 6.0) } else { 4.0 };
                }
                // Out of view, or no room on this side: the other one.
                Err(error) if error.is_local() && !turned => {
                    self.live.tell(Progress::Passed(error.to_string()));
                    (turned, step) = (true, -step);
                }
                Err(error) => return Err(error),
            }
        }
        Err(crate::procedure::ProcedureError::Implausible {
            what: format!(
                "moving scope.{} by {FARTHEST_UM:.0} µm does not move the tip in the picture: does the axis move?",
                if coordinate == Coordinate::X { "x" } else { "y" }
            ),
        }
        .into())
    }

    /// One more sample, at a random place or, every other time, where the map is weakest.
    fn next(&mut self, draws: &mut Draws) -> Result<(), AutoError> {
        let window = self.live.window();
        let margin = MARGIN_SHARE * window.side_px();
        let choice: Vec<Pixel> = (0..CHOICE).map(|_| draws.one().pixel(&window, margin)).collect();
        let centred: Vec<_> = choice.iter().map(|p| self.centred(*p)).collect();
        let weak = self.fit.as_ref().filter(|_| self.place.samples.len().is_multiple_of(2));
        let pixel = choice[weak.and_then(|fit| weakest(&fit.solution, &centred)).unwrap_or(0)];
        let map = self.map().ok_or_else(|| crate::procedure::ProcedureError::Implausible {
            what: "scope.x and scope.y move the tip the same way in the picture: do both axes move?".into(),
        })?;
        self.move_xy(map.apply(&self.centred(pixel)))?;
        let expected = Expected { pixel, within_px: ASTRAY_SHARE * window.side_px() };
        let seen = self.look(Some(expected))?;
        self.keep(&seen)
    }
}
