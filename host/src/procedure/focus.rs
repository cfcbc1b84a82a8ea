//! How a procedure brings an axis into focus: the board's scan, or what stands in for it.

use super::error::ProcedureError;
use crate::autofocus::run;
use crate::autofocus::source::CameraSource;
use crate::focus::Measure;
use crate::frames::camera::Camera;
use crate::link::explain::scan_refusal;
use crate::picture::Roi;
use crate::rig::AxisName;
use crate::stage::{Stage, StageError};
use parfocal_protocol::autofocus::{Mode, Outcome, ScanId, ScanParameters, Strategy, Subject};
use parfocal_protocol::units::{Axis, Micrometres, MicrometresPerSecond, Milliseconds};

/// What to focus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FocusTask {
    /// The axis that moves.
    pub axis: AxisName,
    /// The lowest position it may visit.
    pub low: Micrometres,
    /// The highest.
    pub high: Micrometres,
    /// The region of the frame whose focus counts.
    pub region: Roi,
    /// Depth of field of the objective in use, µm, if it is known: what lengths of a scan are counted in.
    pub depth_of_field_um: Option<f64>,
}

/// Depth of field when it is not known, µm: 40x/0.8 W.
const DEPTH_UM: f64 = 1.0;

impl FocusTask {
    /// A climb that stops for every frame, its lengths in depths of field, on the board's axis `axis`.
    ///
    /// # Errors
    /// [`StageError::NoPosition`]: a length or a place that no stage has.
    pub fn parameters(&self, axis: Axis, scan: ScanId) -> Result<ScanParameters, StageError> {
        let nm = |at: Micrometres| at.nanometres().ok_or(StageError::NoPosition { name: self.axis, at: at.0 });
        let depth = self.depth_of_field_um.unwrap_or(DEPTH_UM);
        let depths = |n: f64| nm(Micrometres(n * depth));
        Ok(ScanParameters {
            scan,
            axis,
            strategy: Strategy::Climb,
            mode: Mode::Step,
            subject: Subject::Peak,
            low: nm(self.low)?,
            high: nm(self.high)?,
            sample_step: depths(0.5)?,
            trap: depths(10.0)?,
            probe: depths(5.0)?,
            speed: MicrometresPerSecond(0.0),
            sample_timeout: Milliseconds(2000),
            verify: false,
        })
    }
}

/// Brings an axis into focus.
pub trait Focuser {
    /// Moves `task.axis` to the focus and says where that is.
    ///
    /// # Errors
    /// [`ProcedureError::NotFocused`] when there is no focus to be sure of; the axis is then back where it was.
    fn focus(
        &mut self,
        stage: &mut Stage,
        camera: &mut dyn Camera,
        task: &FocusTask,
        keep_on: &dyn Fn() -> bool,
    ) -> Result<Micrometres, ProcedureError>;
}

/// The board's own scan, fed with the camera's frames.
#[derive(Clone, Copy, Debug)]
pub struct ScanFocuser {
    /// The focus measure.
    pub measure: Measure,
    next: u16,
}

impl ScanFocuser {
    /// Scans with `measure`; `first` begins their numbers, which the board tells apart.
    pub fn new(measure: Measure, first: u16) -> Self {
        Self { measure, next: first }
    }
}

impl Focuser for ScanFocuser {
    fn focus(
        &mut self,
        stage: &mut Stage,
        camera: &mut dyn Camera,
        task: &FocusTask,
        keep_on: &dyn Fn() -> bool,
    ) -> Result<Micrometres, ProcedureError> {
        let (link, axis) = stage.find(task.axis)?;
        self.next = self.next.wrapping_add(1).max(1);
        let parameters = task.parameters(axis, ScanId(self.next))?;
        let mut source = CameraSource::new(camera, Some(task.region), self.measure, None);
        let scanned = run(link, &parameters, &mut source, &mut |_| {}, keep_on)?;
        if !keep_on() {
            return Err(StageError::Interrupted.into());
        }
        match scanned.report.outcome {
            Outcome::Focused => Ok(scanned.report.end.micrometres()),
            Outcome::Refused(why) => Err(ProcedureError::NotFocused { axis: task.axis, reason: scan_refusal(why) }),
        }
    }
}
