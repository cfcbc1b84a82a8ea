//! After a change of pipette.

use crate::eyes::{Ran, Wrongs, faulty, work};
use crate::unattended::send_to_random_pixels;
use crate::world::{World, m1, rig_file};
use parfocal::autonomous::{Plan, Recalibrated, recalibrate};
use parfocal::rig::{CameraCalibration, Pipette, Record, Registration, Rig};
use parfocal_simulator::model::RigModel;

/// The rig's file as calibrations of this model without any error would leave it.
fn calibrated(model: &RigModel) -> Rig {
    let mut rig = rig_file();
    let record = || Record {
        date: "2026-11-25T00:00:00Z".into(),
        seed: 0,
        samples: "none".into(),
        tolerance_um: 1.0,
        rms_um: 0.0,
        residuals_um: vec![0.0],
        rejected: Vec::new(),
        certainty: None,
    };
    rig.set_camera_calibration(CameraCalibration {
        matrix_um_per_px: model.camera.matrix_um_per_px,
        objective: Some("40x".into()),
        record: record(),
    })
    .unwrap();
    let held = &model.manipulators[0];
    let row = |i: usize| [held.joints[i][0], held.joints[i][1], held.joints[i][2], held.origin_um[i]];
    rig.set_registration(
        m1(),
        Registration {
            model: "affine".into(),
            matrix: [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
            record: record(),
        },
    );
    let (descent_deg, azimuth_deg) = (held.descent_rad.to_degrees(), held.azimuth_rad.to_degrees());
    rig.set_pipette(m1(), Pipette { descent_deg, azimuth_deg, source: "axis".into(), date: record().date });
    rig
}

/// A new pipette whose tip is elsewhere by `by_um`, measured.
fn change(rig: &Rig, by_um: [f64; 3], seed: u64, wrongs: &Wrongs) -> (World, Ran<Recalibrated>) {
    let mut model = faulty(seed);
    for (origin, by) in model.manipulators[0].origin_um.iter_mut().zip(by_um) {
        *origin += by;
    }
    let world = World::new(model);
    let plan = Plan::new(vec![m1()], seed);
    let date = "2026-11-26T00:00:00Z";
    let ran = work(&world, seed, wrongs, &mut |work| recalibrate(work, rig, m1(), &plan, date.into()));
    (world, ran)
}

fn off(found: &Recalibrated, by_um: [f64; 3]) -> f64 {
    found.offset.offset_um.iter().zip(by_um).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn one_focus_and_one_detection_put_a_new_tip_in_force() {
    let mut rig = calibrated(&faulty(11));
    let by = [14.0, -9.0, 6.0];
    let (world, ran) = change(&rig, by, 11, &Wrongs::default());
    let found = ran.result.unwrap();
    assert!(off(&found, by) < 1.5, "{found:?}");
    assert!((found.moved_um - 17.7).abs() < 1.5 && ran.frames < 20, "{found:?}, {} frames", ran.frames);
    assert!(send_to_random_pixels(&world, &rig, m1(), 11) > 10.0, "the old offset is wrong now");
    assert_eq!(rig.add_tip_offset(m1(), found.offset).unwrap(), None);
    let worst = send_to_random_pixels(&world, &rig, m1(), 11);
    assert!(worst < 1.5, "{worst:.2} µm");
}

#[test]
fn the_history_is_kept_and_a_place_unlike_all_of_it_is_warned_of() {
    let mut rig = calibrated(&faulty(12));
    let changes = [[3.0, 1.0, 2.0], [-4.0, 2.0, 0.0], [1.0, -3.0, -2.0], [2.0, 58.0, 1.0]];
    for (k, by) in changes.into_iter().enumerate() {
        let found = change(&rig, by, 12 + k as u64, &Wrongs::default()).1.result.unwrap();
        assert!(off(&found, by) < 1.5, "{by:?}: {found:?}");
        let warning = rig.add_tip_offset(m1(), found.offset).unwrap();
        assert_eq!(warning.is_some(), k == 3, "{by:?}: {warning:?}");
    }
    let history = &rig.contents().manipulators[&m1()].tip_offsets;
    assert_eq!(history.len(), changes.len());
    // As the file keeps it.
    assert_eq!(Rig::parse(&rig.to_text().unwrap()).unwrap().contents(), rig.contents());
}

#[test]
fn what_is_not_the_new_tip_is_not_taken_for_it() {
    let rig = calibrated(&faulty(13));
    // Dirt that points another way, and the tip of the other manipulator, which points the other way.
    let wrongs = Wrongs { stray_tip: Some([500.0, 100.0]), ..Wrongs::default() };
    let by = [5.0, 5.0, -5.0];
    let found = change(&rig, by, 13, &wrongs).1.result.unwrap();
    assert!(off(&found, by) < 1.5, "{found:?}");
    // No new pipette at all.
    let wrongs = Wrongs { missing: vec![0], ..Wrongs::default() };
    let error = change(&rig, by, 13, &wrongs).1.result.unwrap_err().to_string();
    assert!(error.contains("no tip is seen") && error.contains("broken or missing"), "{error}");
}
