//! Tips brought into view before they are calibrated, by what the printed markers say of them.

use super::all::Work;
use super::error::AutoError;
use crate::procedure::{IntoViewPlan, LiveRig, Parts, PointFinder, Purpose, Recorder, into_view};
use crate::rig::{ManipulatorNumber, Rig};

/// What it takes to bring tips into view.
pub struct Turret<'a> {
    /// Objectives to look through, from the weakest to the one that is calibrated with.
    pub through: &'a [String],
    /// Puts one into the light path.
    pub change: &'a mut dyn FnMut(&str) -> Result<(), String>,
    /// What sees a tip.
    pub finder: &'a mut dyn PointFinder,
}

/// Brings a manipulator's tip into the picture's middle, in focus, and corrects its coarse registration by where it was. Without a turret
/// tips are where a person has brought them, and nothing moves.
///
/// # Errors
/// As [`into_view`].
pub(super) fn bring(
    work: &mut Work<'_>,
    rig: &mut Rig,
    manipulator: ManipulatorNumber,
    date: String,
    save: &mut dyn FnMut(&mut Rig) -> Result<(), AutoError>,
) -> Result<(), AutoError> {
    let Some(turret) = &mut work.turret else { return Ok(()) };
    let plan = IntoViewPlan { manipulator, objectives: turret.through.to_vec() };
    let before = rig.clone();
    let mut live = LiveRig::new(Parts {
        stage: work.stage,
        camera: work.camera,
        focuser: work.focuser,
        rig: &before,
        keep_on: work.keep_on,
        progress: work.progress,
    })?;
    // The file knows at once which objective is in the light path, whatever becomes of the search.
    let mut change = |name: &str| {
        (turret.change)(name)?;
        rig.set_objective_in_use(Some(name)).map_err(|e| e.to_string())?;
        save(rig).map_err(|e| e.to_string())
    };
    let recorder = &mut Recorder::memory(Purpose::Registration);
    let found = into_view(&mut live, turret.finder, &plan, &mut change, recorder)?;
    found.put(rig, manipulator, date)?;
    save(rig)
}
