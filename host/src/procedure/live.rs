//! A rig at work: its stage guarded, its camera's frames fresh, its focus found, its points looked for.

use super::error::ProcedureError;
use super::focus::{FocusTask, Focuser};
use super::guard::{Guard, Pose};
use super::level::level;
use super::point::{Found, FramePixel, Hint, NotFound, PointFinder, Subject, Window, Witness};
use crate::calibration::chain::{Pixel, Sensor};
use crate::frames::camera::{Camera, Frame};
use crate::link::transport::later;
use crate::picture::Roi;
use crate::rig::{AxisName, Coordinate, Device, Rig};
use crate::stage::Stage;
use nalgebra::Vector3;
use parfocal_protocol::units::{HostTime, Micrometres};

/// What a procedure says while it runs.
#[derive(Clone, Debug)]
pub enum Progress {
    /// It begins something, in words.
    Begins(String),
    /// An axis is in focus.
    Focused {
        /// The axis.
        axis: AxisName,
        /// Where.
        at: Micrometres,
    },
    /// A point was found, in the sensor's pixels.
    Found {
        /// What.
        subject: Subject,
        /// Where.
        pixel: Pixel,
        /// How sure, 0 to 1.
        confidence: f64,
    },
    /// A sample was recorded.
    Recorded {
        /// So many now.
        done: usize,
        /// Of so many.
        of: usize,
    },
    /// A place gave no sample and was passed over.
    Passed(String),
    /// Something to know, nothing to stop for.
    Warning(String),
}

/// What a procedure works with. Borrowed, so that its owner has all of it back afterwards.
pub struct Parts<'a> {
    /// The axes.
    pub stage: &'a mut Stage,
    /// The camera; its clock is the stage's.
    pub camera: &'a mut dyn Camera,
    /// How an axis is brought into focus.
    pub focuser: &'a mut dyn Focuser,
    /// What is known of the rig. Procedures return what they found; putting it in force is the caller's.
    pub rig: &'a Rig,
    /// Asked all the while; false stops what moves and ends the procedure.
    pub keep_on: &'a dyn Fn() -> bool,
    /// Told how it goes.
    pub progress: &'a mut dyn FnMut(Progress),
}

/// A rig at work.
pub struct LiveRig<'a> {
    /// Its guarded stage.
    pub guard: Guard<'a>,
    camera: &'a mut dyn Camera,
    focuser: &'a mut dyn Focuser,
    progress: &'a mut dyn FnMut(Progress),
    window: Window,
    angle_deg: Option<f64>,
}

/// A point that was found, in the sensor's pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Where on the sensor.
    pub pixel: Pixel,
    /// The finder's own words.
    pub found: Found,
}

/// How long to wait for a frame, ms.
const PATIENCE_MS: u64 = 3000;
/// Frames thrown away before a camera counts as showing only the past.
const STALE: usize = 64;
/// Scans of a first look before its refusal counts.
const FIRST_TRIES: usize = 3;
/// A blurred tip is still recognised within about this many depths of field; heights to look at are so far apart.
const SEEK_DEPTHS: f64 = 12.0;
/// Looks that agree are within this share of the picture's shorter side of each other…
const AGREE_SHARE: f64 = 0.015;
/// … and after so many that do not the point counts as unseen.
const LOOKS: usize = 6;
/// Side of the region whose focus is the tip's, px of the frame: larger ones focus on the shank (docs/autofocus.md).
const FOCUS_SIDE: usize = 48;

impl<'a> LiveRig<'a> {
    /// Begins: takes one frame to see that the camera is as the rig's file says.
    ///
    /// # Errors
    /// No frame, or one of another size than the file's camera.
    pub fn new(parts: Parts<'a>) -> Result<Self, ProcedureError> {
        let guard = Guard::new(parts.stage, parts.rig, parts.keep_on);
        let Parts { camera, focuser, progress, rig, .. } = parts;
        let sensor = Sensor { width_px: 0, height_px: 0 };
        let mut live = Self { guard, camera, focuser, progress, window: Window::whole(sensor), angle_deg: None };
        let frame = live.fresh_frame()?;
        let (w, h) = (frame.picture.width, frame.picture.height);
        live.window = match &rig.contents().camera {
            Some(camera) => Window::of(camera),
            None => Window::whole(Sensor { width_px: w as u32, height_px: h as u32 }),
        };
        let (ew, eh) = live.window.frame_size();
        if (w, h) != (ew, eh) {
            return Err(ProcedureError::FrameSize { found: format!("{w}x{h}"), expected: format!("{ew}x{eh}") });
        }
        Ok(live)
    }

    /// The part of the sensor that frames show.
    pub fn window(&self) -> Window {
        self.window
    }

    /// The rig's file.
    pub fn rig(&self) -> &'a Rig {
        self.guard.rig()
    }

    /// The direction in which the tip that is looked for from now on points in frames, degrees from x (right) towards y (down).
    pub fn expect_angle(&mut self, angle_deg: f64) {
        self.angle_deg = Some(angle_deg);
    }

    /// Tells how it goes.
    pub fn tell(&mut self, progress: Progress) {
        (self.progress)(progress);
    }

    /// Where everything is.
    ///
    /// # Errors
    /// A board does not answer.
    pub fn pose(&mut self) -> Result<Pose, ProcedureError> {
        Ok(self.guard.pose()?)
    }

    /// P_M now, µm.
    ///
    /// # Errors
    /// A board does not answer.
    pub fn microscope(&mut self) -> Result<Vector3<f64>, ProcedureError> {
        Ok(self.pose()?.microscope(self.rig()))
    }

    /// Moves, guarded.
    ///
    /// # Errors
    /// As [`Guard::move_to`].
    pub fn move_to(&mut self, targets: &[(AxisName, Micrometres)]) -> Result<(), ProcedureError> {
        self.guard.move_to(targets)
    }

    /// A frame whose exposure began after the last move had ended. A camera that tells no exposure times may deliver one
    /// old frame first, which is thrown away.
    ///
    /// # Errors
    /// The camera is gone, or shows only the past.
    pub fn fresh_frame(&mut self) -> Result<Frame, ProcedureError> {
        self.fresh_part(None).map(|(frame, _)| frame)
    }

    /// As [`Self::fresh_frame`] when only a part of it matters; what remains to be cut out of the frame comes with it.
    pub(super) fn fresh_part(&mut self, part: Option<Roi>) -> Result<(Frame, Option<Roi>), ProcedureError> {
        let since = self.guard.moved();
        let deadline: HostTime = later(self.guard.stage().now(), PATIENCE_MS);
        let mut arrived = false;
        for _ in 0..STALE {
            if !self.guard.keep_on() {
                return Err(crate::stage::StageError::Interrupted.into());
            }
            let Some((frame, left)) = self.camera.next_part(deadline, part)? else { break };
            match frame.exposure {
                Some((begin, _)) if begin >= since => return Ok((frame, left)),
                None if frame.arrival >= since && arrived => return Ok((frame, left)),
                None => arrived |= frame.arrival >= since,
                Some(_) => {}
            }
        }
        Err(ProcedureError::NoFreshFrame { millis: PATIENCE_MS })
    }

    /// Brings an axis into focus on a square region around a pixel, between two positions, and says where that is. Every
    /// tip's way is checked for the whole range before anything moves.
    ///
    /// # Errors
    /// [`ProcedureError::NotFocused`] when the board refuses (the axis is back where it was), an obstacle, or a fault.
    pub fn focus(
        &mut self,
        axis: AxisName,
        around: Pixel,
        range: (Micrometres, Micrometres),
    ) -> Result<Micrometres, ProcedureError> {
        let region = self.window.region(around, FOCUS_SIDE);
        let settings = self.guard.stage().settings(axis)?;
        let low = range.0.0.max(settings.low.micrometres().0);
        let high = range.1.0.min(settings.high.micrometres().0);
        let depth_of_field_um = self.depth_of_field_um();
        let task = FocusTask { axis, low: Micrometres(low), high: Micrometres(high), region, depth_of_field_um };
        let from = self.pose()?;
        for end in [task.low, task.high] {
            self.guard.check_from(&from, &[(axis, end)])?;
        }
        let camera = &mut *self.camera;
        let (stage, keep_on) = self.guard.parts();
        let focused = self.focuser.focus(stage, camera, &task, keep_on);
        self.guard.moved_now();
        let at = focused?;
        self.tell(Progress::Focused { axis, at });
        Ok(at)
    }

    /// As [`Self::focus`] for what may be a tip: if one is seen there, its height is where its glass is sharp, not one of the
    /// two peaks beside it.
    ///
    /// # Errors
    /// As [`Self::focus`].
    pub fn focus_tip(
        &mut self,
        axis: AxisName,
        around: Pixel,
        range: (Micrometres, Micrometres),
    ) -> Result<Micrometres, ProcedureError> {
        let at = self.focus(axis, around, range)?;
        Ok(level(self, axis, around, range)?.unwrap_or(at))
    }

    /// Looks for a point in a fresh frame. With `expected` and `within_px` (of the sensor) nothing farther off is taken.
    ///
    /// # Errors
    /// [`ProcedureError::NotFound`], or no fresh frame.
    pub fn find(
        &mut self,
        finder: &mut dyn PointFinder,
        subject: &Subject,
        expected: Option<Pixel>,
        within_px: Option<f64>,
    ) -> Result<Seen, ProcedureError> {
        let frame = self.fresh_frame()?;
        let to_frame = |pixel| self.window.to_frame(pixel);
        let scale = |px: f64| {
            let unit = FramePixel { x_px: 0.0, y_px: 0.0 };
            let [a, b] = [unit, FramePixel { x_px: 1.0, ..unit }].map(|at| self.window.to_sensor(at).x_px);
            px / (b - a)
        };
        let (expected, within_px) = (expected.map(to_frame), within_px.map(scale));
        let hint = Hint { subject: subject.clone(), expected, within_px, angle_deg: self.angle_deg };
        let found = finder.find(&frame, &hint)?;
        if !hint.allows(found.at) {
            let off = hint.expected.map_or(0.0, |e| e.distance_px(found.at));
            let within = hint.within_px.unwrap_or(0.0);
            let (off_px, within_px) = (off.round() as u32, within.round() as u32);
            return Err(NotFound::Elsewhere { subject: subject.clone(), off_px, within_px }.into());
        }
        let seen = Seen { pixel: self.window.to_sensor(found.at), found };
        self.tell(Progress::Found { subject: subject.clone(), pixel: seen.pixel, confidence: found.confidence });
        Ok(seen)
    }

    /// Looks for a point of which nobody knows where it should be, until two looks agree: a detector that is wrong now and then
    /// is not wrong twice in the same way. A person is believed at once.
    ///
    /// # Errors
    /// As [`Self::find`]; no two looks agree.
    pub fn find_agreed(&mut self, finder: &mut dyn PointFinder, subject: &Subject) -> Result<Seen, ProcedureError> {
        let within = AGREE_SHARE * self.window.side_px();
        let mut before: Vec<Seen> = Vec::new();
        for _ in 0..LOOKS {
            let seen = self.find(finder, subject, None, None)?;
            let agrees =
                |old: &Seen| (old.pixel.x_px - seen.pixel.x_px).hypot(old.pixel.y_px - seen.pixel.y_px) <= within;
            if seen.found.by == Witness::Click || before.iter().any(agrees) {
                return Ok(seen);
            }
            before.push(seen);
        }
        Err(NotFound::Unseen(subject.clone()).into())
    }

    /// Looks for a point where it is, and if it is not seen, at heights farther and farther away: a tip far out of focus is
    /// not recognised. The microscope's z stays where the point was seen; it goes back when it was seen nowhere.
    ///
    /// # Errors
    /// As [`Self::find`] and [`Self::move_to`].
    pub fn seek(
        &mut self,
        finder: &mut dyn PointFinder,
        subject: &Subject,
        reach_um: f64,
    ) -> Result<Seen, ProcedureError> {
        let z = AxisName { device: Device::Scope, coordinate: Coordinate::Z };
        let first = match self.find_agreed(finder, subject) {
            Err(ProcedureError::NotFound(NotFound::Unseen(_) | NotFound::Passed(_))) => self.pose()?.axis(z),
            other => return other,
        };
        self.tell(Progress::Begins(format!("{subject} is not seen here: looking {reach_um:.0} µm up and down.")));
        let step = SEEK_DEPTHS * self.depth_of_field_um().unwrap_or(1.0);
        let rungs = (reach_um / step).floor() as i32;
        for k in 1..=rungs {
            for side in [1.0, -1.0] {
                let at = Micrometres(first.0 + side * step * f64::from(k));
                match self.move_to(&[(z, at)]).and_then(|()| self.find_agreed(finder, subject)) {
                    Err(error) if error.is_local() => {}
                    other => return other,
                }
            }
        }
        self.move_to(&[(z, first)])?;
        Err(NotFound::Unseen(subject.clone()).into())
    }

    /// Depth of field of the objective in use, if the rig's file has it.
    pub(super) fn depth_of_field_um(&self) -> Option<f64> {
        self.rig().contents().objectives.get(self.guard.objective()?)?.depth_of_field_um
    }

    /// As [`Self::focus_on`] for the first look at a point, on which everything rests: a refused scan is repeated.
    ///
    /// # Errors
    /// As [`Self::focus_on`].
    pub fn first_focus_on(
        &mut self,
        finder: &mut dyn PointFinder,
        subject: &Subject,
        reach_um: f64,
    ) -> Result<Seen, ProcedureError> {
        for _ in 1..FIRST_TRIES {
            match self.focus_on(finder, subject, None, reach_um) {
                Err(error @ ProcedureError::NotFocused { .. }) => self.tell(Progress::Passed(error.to_string())),
                other => return other,
            }
        }
        self.focus_on(finder, subject, None, reach_um)
    }

    /// Brings a point into focus with the microscope's z and says where it then is. `expected` is where it should be, if
    /// that is known; else it is looked for first, as blurred as it is. `reach_um` is how far from the present height its
    /// focus may be.
    ///
    /// # Errors
    /// As [`Self::find`] and [`Self::focus`].
    pub fn focus_on(
        &mut self,
        finder: &mut dyn PointFinder,
        subject: &Subject,
        expected: Option<Pixel>,
        reach_um: f64,
    ) -> Result<Seen, ProcedureError> {
        let z = AxisName { device: Device::Scope, coordinate: Coordinate::Z };
        let rough = match expected {
            Some(pixel) => pixel,
            None => self.seek(finder, subject, reach_um)?.pixel,
        };
        let around = |at: Micrometres| (Micrometres(at.0 - reach_um), Micrometres(at.0 + reach_um));
        let here = self.pose()?.axis(z);
        self.focus_tip(z, rough, around(here))?;
        let again = |live: &mut Self, finder: &mut dyn PointFinder, near: Pixel| match expected {
            Some(_) => live.find(finder, subject, Some(near), None),
            None => live.find_agreed(finder, subject),
        };
        let seen = again(self, finder, rough)?;
        // Focused on something beside it: once more, on itself.
        let off = (seen.pixel.x_px - rough.x_px).hypot(seen.pixel.y_px - rough.y_px);
        if off <= FOCUS_SIDE as f64 / 3.0 {
            return Ok(seen);
        }
        let here = self.pose()?.axis(z);
        self.focus_tip(z, seen.pixel, around(here))?;
        again(self, finder, seen.pixel)
    }
}
