//! Files of the simulated rig, calibrated by its own geometry: what other tests show to be found by measuring.

use parfocal::rig::{CameraCalibration, CoarseRegistration, ManipulatorNumber, Pipette, Record, Rig, Zoom};
use parfocal_simulator::model::{ObjectiveModel, RigModel};
use parfocal_tests::rig_file::{boards_and_axes, record};

/// When all this was measured.
pub const DATE: &str = "2026-11-26T00:00:00Z";

fn model() -> RigModel {
    let mut model = RigModel::new(0);
    model.objectives.push(ObjectiveModel::SEARCHER);
    model
}

/// Camera and these objectives are calibrated; the turret's others are known by name.
pub fn calibrated(objectives: &[&str]) -> Rig {
    let model = model();
    let mut text = String::from("schema = 1\nobjective_in_use = \"40x\"\n[objectives.40x]\ndefault = true\n");
    text += "[camera]\nwidth_px = 640\nheight_px = 480\n";
    text += "[markers]\ntag_mm = 8.0\nsubstrate = 0\nobjective = 3\n[markers.manipulators]\nm1 = 1\n";
    text += &boards_and_axes();
    let mut rig = Rig::parse(&text).unwrap();
    let record = Record { date: DATE.into(), ..record() };
    let matrix_um_per_px = model.camera.matrix_um_per_px;
    rig.set_camera_calibration(CameraCalibration { matrix_um_per_px, objective: None, record }).unwrap();
    for o in &model.objectives {
        let entry = rig.contents_mut().objectives.entry(o.name.into()).or_default();
        entry.depth_of_field_um = Some(o.depth_of_field_um);
        if objectives.contains(&o.name) {
            rig.set_zoom(o.name, Zoom { zoom: 1.0, alpha: o.alpha, kappa_um: o.kappa_um, record: None });
        }
    }
    rig
}

/// Manipulator 1 is known by its marker, 150 µm off.
pub fn known_by_its_marker(rig: &mut Rig) {
    let m1 = &model().manipulators[0];
    let row = |r: usize| [m1.joints[r][0], m1.joints[r][1], m1.joints[r][2], m1.origin_um[r] + 150.0];
    let matrix = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
    let coarse = CoarseRegistration { matrix, error_um: 260.0, error_deg: 0.4, joints_um: [0.0; 3], date: DATE.into() };
    let (descent_deg, azimuth_deg) = (m1.descent_rad.to_degrees(), m1.azimuth_rad.to_degrees());
    let pipette = Pipette { descent_deg, azimuth_deg, source: parfocal::rig::MARKERS.into(), date: DATE.into() };
    rig.set_coarse(ManipulatorNumber::new(1).unwrap(), coarse, Some(pipette));
}
