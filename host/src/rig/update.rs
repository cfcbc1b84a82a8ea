//! Changes of one thing that leave the rest alone: a board, an objective's height, one κ, one pipette's tip.

use super::contents::{
    Axis, Board, CameraCalibration, Contents, Moves, Objective, Pipette, Registration, TipOffset, Um3, Zoom,
};
use super::markers::{CoarseRegistration, MARKERS};
use super::names::{AxisName, BoardId, ManipulatorNumber};
use super::{Rig, RigError};
use std::fmt;

/// A new tip lies far from where this manipulator's tips have been: a slipped pipette, a wrong click, a wrong objective.
#[derive(Clone, Debug, PartialEq)]
pub struct TipOffsetWarning {
    /// Whose tip.
    pub manipulator: ManipulatorNumber,
    /// From the median of the earlier ones.
    pub distance_um: f64,
    /// What was usual: three robust standard deviations of the earlier ones.
    pub usual_um: f64,
}

impl fmt::Display for TipOffsetWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { manipulator, distance_um, usual_um } = self;
        write!(
            f,
            "the new tip of {manipulator} is {distance_um:.0} µm from where its tips usually are (within {usual_um:.0} µm): \
             check the objective in use and that the tip is the pipette's"
        )
    }
}

impl Rig {
    /// Adds a board, or changes which one it is.
    pub fn set_board(&mut self, name: &str, unique_id: BoardId) {
        self.contents.boards.insert(name.into(), Board { unique_id });
    }

    /// Says which board and index an axis is.
    pub fn set_axis(&mut self, name: AxisName, axis: Axis) {
        self.contents.axes.entry(name.device).or_default().insert(name.coordinate, axis);
    }

    /// An axis, if the rig has it.
    pub fn axis(&self, name: AxisName) -> Option<&Axis> {
        self.contents.axes.get(&name.device)?.get(&name.coordinate)
    }

    /// Whether a microscope's axis moves the objective (counts in P_M) rather than the sample.
    pub fn moves_objective(&self, name: AxisName) -> bool {
        self.axis(name).and_then(|axis| axis.moves) == Some(Moves::Objective)
    }

    /// Says which objective is in the light path; `None` when nobody knows.
    ///
    /// # Errors
    /// [`RigError::Unknown`] with the objectives there are.
    pub fn set_objective_in_use(&mut self, name: Option<&str>) -> Result<(), RigError> {
        if let Some(name) = name {
            objective(&mut self.contents, name)?;
        }
        self.contents.objective_in_use = name.map(Into::into);
        Ok(())
    }

    /// Puts a measured camera matrix in force.
    ///
    /// # Errors
    /// [`RigError::Unknown`] when the rig has no camera entry yet.
    pub fn set_camera_calibration(&mut self, calibration: CameraCalibration) -> Result<(), RigError> {
        let camera = self.contents.camera.as_mut().ok_or(RigError::Unknown {
            what: "the section",
            name: "camera".into(),
            known: vec!["no [camera] yet: add it with width_px and height_px".into()],
        })?;
        camera.calibration = Some(calibration);
        Ok(())
    }

    /// Sets α and κ of an objective at one zoom; adds the objective if it is new.
    pub fn set_zoom(&mut self, name: &str, zoom: Zoom) {
        let objective = self.contents.objectives.entry(name.into()).or_default();
        match objective.zooms.iter_mut().find(|present| present.zoom == zoom.zoom) {
            Some(present) => *present = zoom,
            None => objective.zooms.push(zoom),
        }
    }

    /// Corrects one objective's κ alone, at one zoom.
    ///
    /// # Errors
    /// [`RigError::Unknown`] with the objectives, or zooms, there are.
    pub fn set_kappa(&mut self, name: &str, zoom: f64, kappa_um: Um3) -> Result<(), RigError> {
        zoom_entry(&mut self.contents, name, zoom)?.kappa_um = kappa_um;
        Ok(())
    }

    /// Corrects all objectives' heights after the coarse focus knob was turned: what is in focus lies `rise_um` higher in ref
    /// than before at the same microscope position. Manipulators, obstacles and everything else in ref stay where they are.
    pub fn shift_focus(&mut self, rise_um: f64) {
        self.contents.objective_height_um += rise_um;
    }

    /// Puts a coarse registration beside the fine one, which it leaves as it is; with it the pipette's direction as the markers show it,
    /// unless a better one is known. Says whether the direction was taken.
    pub fn set_coarse(
        &mut self,
        number: ManipulatorNumber,
        coarse: CoarseRegistration,
        pipette: Option<Pipette>,
    ) -> bool {
        let manipulator = self.contents.manipulators.entry(number).or_default();
        manipulator.coarse = Some(coarse);
        let open = manipulator.pipette.as_ref().is_none_or(|p| p.source == MARKERS);
        let taken = pipette.filter(|_| open);
        let changed = taken.is_some();
        manipulator.pipette = taken.or(manipulator.pipette.take());
        changed
    }

    /// Takes a manipulator's fine registration and its pipette's direction out of force: a hand has set it down elsewhere.
    pub fn set_down(&mut self, number: ManipulatorNumber) {
        if let Some(manipulator) = self.contents.manipulators.get_mut(&number) {
            manipulator.registration = None;
            manipulator.tip_offsets.clear();
            manipulator.pipette = None;
        }
    }

    /// Puts a manipulator's registration in force. Tip offsets are counted from it, so the history starts anew.
    pub fn set_registration(&mut self, number: ManipulatorNumber, registration: Registration) {
        let manipulator = self.contents.manipulators.entry(number).or_default();
        manipulator.registration = Some(registration);
        manipulator.tip_offsets.clear();
    }

    /// Sets the direction of a manipulator's pipette.
    pub fn set_pipette(&mut self, number: ManipulatorNumber, pipette: Pipette) {
        self.contents.manipulators.entry(number).or_default().pipette = Some(pipette);
    }

    /// Adds a tip measured after a change of pipette; it counts from now on. Warns when it is unlike the earlier ones
    /// (at least 3): farther than three robust standard deviations and 50 µm from their median.
    ///
    /// # Errors
    /// [`RigError::Unknown`] for a manipulator that is not registered.
    pub fn add_tip_offset(
        &mut self,
        number: ManipulatorNumber,
        offset: TipOffset,
    ) -> Result<Option<TipOffsetWarning>, RigError> {
        let known = || self.contents.manipulators.keys().map(ToString::to_string).collect();
        if self.contents.manipulators.get(&number).is_none_or(|m| m.registration.is_none()) {
            return Err(RigError::Unknown {
                what: "the registered manipulator",
                name: number.to_string(),
                known: known(),
            });
        }
        let history = &mut self.contents.manipulators.entry(number).or_default().tip_offsets;
        let warning = unlike(history, &offset.offset_um).map(|(distance_um, usual_um)| TipOffsetWarning {
            manipulator: number,
            distance_um,
            usual_um,
        });
        history.push(offset);
        Ok(warning)
    }
}

/// Distance from the history's median, and what is usual, when the first exceeds the second.
fn unlike(history: &[TipOffset], new: &Um3) -> Option<(f64, f64)> {
    if history.len() < 3 {
        return None;
    }
    let centre: Um3 = std::array::from_fn(|k| median(history.iter().map(|tip| tip.offset_um[k]).collect()));
    let from_centre = |p: &Um3| p.iter().zip(centre).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    let spread = median(history.iter().map(|tip| from_centre(&tip.offset_um)).collect());
    let usual = (3.0 * 1.4826 * spread).max(50.0);
    let distance = from_centre(new);
    (distance > usual).then_some((distance, usual))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    if values.len() % 2 == 1 { values[middle] } else { (values[middle - 1] + values[middle]) / 2.0 }
}

fn objective<'a>(contents: &'a mut Contents, name: &str) -> Result<&'a mut Objective, RigError> {
    let known = contents.objectives.keys().cloned().collect();
    contents.objectives.get_mut(name).ok_or(RigError::Unknown { what: "the objective", name: name.into(), known })
}

fn zoom_entry<'a>(contents: &'a mut Contents, name: &str, zoom: f64) -> Result<&'a mut Zoom, RigError> {
    let objective = objective(contents, name)?;
    let known = objective.zooms.iter().map(|z| z.zoom.to_string()).collect();
    objective.zooms.iter_mut().find(|z| z.zoom == zoom).ok_or(RigError::Unknown {
        what: "the zoom",
        name: zoom.to_string(),
        known,
    })
}
