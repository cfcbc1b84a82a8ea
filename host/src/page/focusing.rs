//! A scan for focus on the page's frames, its curve shown as it comes.

use super::desk::{CurveSoFar, Desk, Doing};
use super::order::{Focus, OrderError};
use crate::autofocus::source::CameraSource;
use crate::autofocus::{Progress, Sample, run as scan};
use crate::link::explain::scan_refusal;
use crate::stage::Stage;
use parfocal_protocol::autofocus::{Mode, Outcome, ScanId, ScanParameters};
use parfocal_protocol::units::{Axis, Micrometres, MicrometresPerSecond, Milliseconds};
use std::sync::Arc;

/// All local maxima lie within this distance of the focus, µm.
const TRAP_UM: f64 = 10.0;
/// First step to find the uphill direction, µm.
const PROBE_UM: f64 = 5.0;

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
        let parameters = parameters(focus, start, axis, desk.axis(focus.axis).ok_or_else(none)?)?;
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
        let mut source =
            CameraSource { camera: desk.feed.camera(going.clone()), roi: looking.region, measure: looking.measure };
        let mut show = |progress: Progress| {
            if let Progress::Sample(Sample { z, phi }) = progress {
                desk.curve().samples.push((z.0, phi.0));
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

fn parameters(
    focus: &Focus,
    start: Micrometres,
    axis: Axis,
    info: &super::desk::AxisInfo,
) -> Result<ScanParameters, OrderError> {
    let (mut low, mut high) = (info.settings.low.micrometres().0, info.settings.high.micrometres().0);
    if let Some([down, up]) = focus.range_um {
        (low, high) = (low.max(start.0 + down), high.min(start.0 + up));
    }
    if !(low < high) {
        return Err(OrderError::Value(format!("the range leaves nothing of {}'s travel to scan", focus.axis)));
    }
    let nm = |what: &str, um: f64| {
        let cannot = || OrderError::Value(format!("{what} of {um} µm is no length a stage can have"));
        Micrometres(um).nanometres().ok_or_else(cannot)
    };
    Ok(ScanParameters {
        scan: ScanId(rand::random()),
        axis,
        strategy: focus.strategy,
        mode: Mode::Step,
        subject: focus.subject,
        low: nm("a low end", low)?,
        high: nm("a high end", high)?,
        sample_step: nm("a sample step", focus.sample_step.0)?,
        trap: nm("a trap", TRAP_UM)?,
        probe: nm("a probe", PROBE_UM)?,
        speed: MicrometresPerSecond(0.0),
        sample_timeout: Milliseconds(2000),
        verify: false,
    })
}
