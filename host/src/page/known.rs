//! What is calibrated and what is known of the rig, as the page shows it.

use super::desk::Desk;
use crate::calibration::chain::Chain;
use crate::rig::{ManipulatorNumber, Rig};
use serde::Serialize;

/// What is known of the rig.
#[derive(Clone, Debug, Serialize)]
pub struct Known {
    camera: bool,
    pixel_um: Option<[f64; 2]>,
    manipulators: Vec<ManipulatorNumber>,
    /// The one in use.
    objective: Option<String>,
    objectives: Vec<ObjectiveKnown>,
    coarse: Vec<CoarseKnown>,
    /// Body and number of its marker.
    markers: Vec<(String, String)>,
    stereo: bool,
    /// Whether the microscope turns its objectives by itself.
    turret: bool,
    /// Why clicks cannot move anything yet.
    missing: Option<String>,
    kept_in: Option<String>,
}

#[derive(Clone, Debug, Serialize)]
struct ObjectiveKnown {
    name: String,
    default: bool,
    /// Size of its pixel in the default one's, if it is calibrated at the zoom in use.
    alpha: Option<f64>,
    /// Where it looks from where the default one does, µm.
    kappa_um: Option<[f64; 3]>,
}

#[derive(Clone, Debug, Serialize)]
struct CoarseKnown {
    name: ManipulatorNumber,
    error_um: f64,
    error_deg: f64,
    date: String,
}

/// What the rig's file says.
pub fn known(desk: &Desk, rig: &Rig) -> Known {
    let contents = rig.contents();
    let calibration = contents.camera.as_ref().and_then(|camera| camera.calibration.as_ref());
    let size = |[[a, b], [c, d]]: [[f64; 2]; 2], alpha: f64| [alpha * a.hypot(c), alpha * b.hypot(d)];
    let objectives = objectives(rig);
    let in_use = objectives.iter().find(|o| Some(&o.name) == contents.objective_in_use.as_ref());
    let alpha = in_use.and_then(|o| o.alpha);
    let coarse = contents.manipulators.iter().filter_map(|(name, manipulator)| {
        let coarse = manipulator.coarse.as_ref()?;
        let (error_um, error_deg, date) = (coarse.error_um, coarse.error_deg, coarse.date.clone());
        Some(CoarseKnown { name: *name, error_um, error_deg, date })
    });
    Known {
        camera: calibration.is_some(),
        pixel_um: calibration.zip(alpha).map(|(c, alpha)| size(c.matrix_um_per_px, alpha)),
        manipulators: contents.manipulators.iter().filter(|(_, m)| m.registration.is_some()).map(|(n, _)| *n).collect(),
        objective: contents.objective_in_use.clone(),
        coarse: coarse.collect(),
        markers: markers(rig),
        stereo: contents.stereo.is_some(),
        turret: desk.turret.is_some(),
        missing: Chain::of(rig).err().map(|e| e.to_string()),
        kept_in: desk.rig_path.as_ref().map(|path| path.display().to_string()),
        objectives,
    }
}

fn objectives(rig: &Rig) -> Vec<ObjectiveKnown> {
    let zoom = rig.contents().zoom_in_use.unwrap_or(1.0);
    let known = |(name, objective): (&String, &crate::rig::Objective)| {
        let entry = objective.zooms.iter().find(|z| z.zoom == zoom).map(|z| (z.alpha, z.kappa_um));
        let entry = entry.or((objective.default && zoom == 1.0).then_some((1.0, [0.0; 3])));
        let (alpha, kappa_um) = entry.unzip();
        ObjectiveKnown { name: name.clone(), default: objective.default, alpha, kappa_um }
    };
    rig.contents().objectives.iter().map(known).collect()
}

fn markers(rig: &Rig) -> Vec<(String, String)> {
    let Some(markers) = &rig.contents().markers else { return Vec::new() };
    let mut all = vec![("substrate".to_owned(), markers.substrate.to_string())];
    all.extend(markers.objective.iter().map(|id| ("objective".into(), id.to_string())));
    all.extend(markers.manipulators.iter().map(|(number, id)| (number.to_string(), id.to_string())));
    all
}
