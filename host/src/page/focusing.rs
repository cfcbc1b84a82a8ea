//! A scan for focus on the page's frames, its curve shown as it comes.

use super::desk::{AxisInfo, CurveSoFar, Desk, Doing};
use super::order::{Focus, OrderError};
use crate::autofocus::{CameraSource, Latency, Progress, REACH, Sample, run as scan};
use crate::frames::camera::Camera;
use crate::link::explain::scan_refusal;
use crate::link::transport::real_now;
use crate::picture::Roi;
use crate::procedure::{FocusTask, Focuser, ProcedureError};
use crate::rig::CameraLatency;
use crate::stage::{Stage, StageError};
use parfocal_protocol::autofocus::{Outcome, ScanId, ScanParameters};
use parfocal_protocol::units::{Axis, Micrometres};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// A scan that is about to run.
pub struct Scan {
    id: u64,
    focus: Focus,
    parameters: ScanParameters,
    halts: u64,
}

impl Scan {
    /// Looks whether a scan can be, and tells the desk of it.
    ///
    /// # Errors
    /// [`OrderError`]: no such axis, nothing to scan.
    pub fn begin(desk: &Desk, stage: &mut Stage, focus: &Focus) -> Result<Self, OrderError> {
        let start = stage.position(focus.axis)?;
        let (_, axis) = stage.find(focus.axis)?;
        let none = || OrderError::Value(format!("this rig has no axis {}", focus.axis));
        let parameters = parameters(focus, start, axis, desk.axis(focus.axis).ok_or_else(none)?, depth_um(desk))?;
        let halts = desk.halts();
        let id = desk.begin(Doing::Autofocus, format!("focusing with {}", focus.axis));
        *desk.curve() = CurveSoFar { id, axis: Some(focus.axis), ..CurveSoFar::default() };
        Ok(Self { id, focus: *focus, parameters, halts })
    }

    /// Its activity.
    pub fn id(&self) -> u64 {
        self.id
    }

    /// Runs it to its end; the desk shows how it goes.
    pub fn run(self, desk: &Arc<Desk>, stage: &mut Stage) {
        let (axis, halts) = (self.focus.axis, self.halts);
        let looking = desk.looking();
        let own = desk.clone();
        let going = Arc::new(move || own.halts() == halts && !own.cancelled());
        let camera = desk.feed.camera(going.clone());
        let arrival = camera.arrival();
        let mut source = CameraSource::new(camera, looking.region, looking.measure, latency(desk));
        let mut show = |progress: Progress| {
            if let Progress::Sample(Sample { z, phi }) = progress {
                let mut curve = desk.curve();
                curve.samples.push((z.0, phi.0));
                curve.latency_us.push(real_now().0.saturating_sub(arrival.load(Ordering::Relaxed)));
            }
        };
        let scanned = match stage.find(axis) {
            Ok((link, _)) => scan(link, &self.parameters, &mut source, &mut show, &*going).map_err(|e| e.to_string()),
            Err(error) => Err(error.to_string()),
        };
        match scanned {
            Err(why) => {
                desk.curve().refused = Some(why.clone());
                desk.end(false, format!("{axis} not focused: {why}"));
            }
            Ok(scanned) => {
                let report = scanned.report;
                let (end, travel) = (report.end.micrometres().0, report.travel.micrometres().0);
                match report.outcome {
                    Outcome::Focused => {
                        desk.curve().focused_um = Some(report.best.micrometres().0);
                        let frames = report.frames;
                        desk.end(
                            true,
                            format!("{axis} in focus at {end:.2} µm: {travel:.1} µm of travel, {frames} frames"),
                        );
                    }
                    Outcome::Refused(why) => {
                        let why = scan_refusal(why);
                        desk.curve().refused = Some(why.into());
                        desk.end(false, format!("{axis} not focused, {why}; it is at {end:.2} µm"));
                    }
                }
            }
        }
    }
}

/// Focuses for a procedure, with the curve on the desk.
pub struct PageFocuser {
    desk: Arc<Desk>,
    halts: u64,
}

impl PageFocuser {
    /// A focuser that ends when somebody stops or cancels.
    pub fn new(desk: Arc<Desk>) -> Self {
        Self { halts: desk.halts(), desk }
    }
}

impl Focuser for PageFocuser {
    fn focus(
        &mut self,
        stage: &mut Stage,
        camera: &mut dyn Camera,
        task: &FocusTask,
        keep_on: &dyn Fn() -> bool,
    ) -> Result<Micrometres, ProcedureError> {
        let desk = &self.desk;
        let (link, axis) = stage.find(task.axis)?;
        let parameters = task.parameters(axis, scan_id())?;
        let (id, measure) = (desk.activity().id, desk.looking().measure);
        *desk.curve() = CurveSoFar { id, axis: Some(task.axis), ..CurveSoFar::default() };
        let mut source = CameraSource::new(camera, Some(task.region), measure, latency(desk));
        let mut show = |progress: Progress| {
            if let Progress::Sample(Sample { z, phi }) = progress {
                desk.curve().samples.push((z.0, phi.0));
            }
        };
        let scanned = scan(link, &parameters, &mut source, &mut show, keep_on)?;
        if !keep_on() || desk.halts() != self.halts {
            return Err(StageError::Interrupted.into());
        }
        match scanned.report.outcome {
            Outcome::Focused => {
                desk.curve().focused_um = Some(scanned.report.best.micrometres().0);
                Ok(scanned.report.end.micrometres())
            }
            Outcome::Refused(why) => {
                desk.curve().refused = Some(scan_refusal(why).into());
                Err(ProcedureError::NotFocused { axis: task.axis, reason: scan_refusal(why) })
            }
        }
    }
}

/// How late the camera's frames come, if that was calibrated.
fn latency(desk: &Desk) -> Option<Latency> {
    desk.rig().contents().camera.as_ref()?.latency.as_ref().map(CameraLatency::in_force)
}

fn parameters(
    focus: &Focus,
    start: Micrometres,
    axis: Axis,
    info: &AxisInfo,
    depth_of_field_um: Option<f64>,
) -> Result<ScanParameters, OrderError> {
    let (mut low, mut high) = (info.settings.low.micrometres().0, info.settings.high.micrometres().0);
    let [down, up] = focus.range_um.unwrap_or([-REACH.0, REACH.0]);
    (low, high) = (low.max(start.0 + down), high.min(start.0 + up));
    if !(low < high) {
        return Err(OrderError::Value(format!("the range leaves nothing of {}'s travel to scan", focus.axis)));
    }
    let region = Roi { x: 0, y: 0, width: 1, height: 1 };
    let (low, high) = (Micrometres(low), Micrometres(high));
    let task = FocusTask { axis: focus.axis, low, high, region, depth_of_field_um };
    let plain = task.parameters(axis, scan_id())?;
    let step = |um: Micrometres| {
        let cannot = || OrderError::Value(format!("a sample step of {} µm is no length a stage can have", um.0));
        um.nanometres().ok_or_else(cannot)
    };
    let sample_step = focus.sample_step.map(step).transpose()?.unwrap_or(plain.sample_step);
    Ok(ScanParameters { strategy: focus.strategy, subject: focus.subject, sample_step, ..plain })
}

/// A number that the board has not heard.
fn scan_id() -> ScanId {
    ScanId(rand::random())
}

/// Depth of field of the objective in use, if it is known.
fn depth_um(desk: &Desk) -> Option<f64> {
    let rig = desk.rig();
    let contents = rig.contents();
    contents.objectives.get(contents.objective_in_use.as_ref()?)?.depth_of_field_um
}
