//! Heights of a tip through several objectives: the peaks of its focus curve lie beside it, the glass' own blur does not.

use crate::rendered::Rendered;
use crate::world::{World, axis, m1, rig_file};
use nalgebra::Matrix2;
use parfocal::calibration::camera::Options;
use parfocal::calibration::chain::{Pixel, Sensor};
use parfocal::calibration::objective::fit;
use parfocal::calibration::robust::Estimator;
use parfocal::focus::Measure;
use parfocal::procedure::{
    DetectorFinder, LiveRig, ObjectivePlan, Parts, Purpose, Recorder, Sample, ScanFocuser, Subject, objectives,
};
use parfocal_protocol::units::{Axis, Micrometres};
use parfocal_simulator::model::RigModel;

const SENSOR: Sensor = Sensor { width_px: 640, height_px: 480 };

/// The first tip in view, the microscope `above_um` its height.
fn model(seed: u64, above_um: f64) -> RigModel {
    let mut model = RigModel::new(seed);
    model.set_position(0, Axis(2), Micrometres(above_um));
    model.set_position(2, Axis(0), Micrometres(-400.0));
    model
}

/// Does something with the rig that is really seen.
fn work<T>(world: &World, what: impl FnOnce(&mut LiveRig<'_>) -> T) -> T {
    let (mut stage, mut camera) = (world.stage(), Rendered(world.clone()));
    let rig = rig_file();
    let mut focuser = ScanFocuser::new(Measure::Tenengrad, 1);
    let mut silent = |_| {};
    let mut live = LiveRig::new(Parts {
        stage: &mut stage,
        camera: &mut camera,
        focuser: &mut focuser,
        rig: &rig,
        keep_on: &|| true,
        progress: &mut silent,
    })
    .unwrap();
    let done = what(&mut live);
    stage.close();
    done
}

/// How far above the focal plane the tip is after a scan, and after a look at its blur, µm.
fn heights(objective: &str, seed: u64, above_um: f64) -> (f64, f64) {
    let world = World::new(model(seed, above_um));
    assert!(world.lock().set_objective(objective));
    let off = || {
        let rig = world.lock();
        let (view, tip) = (rig.viewpoint(rig.now()), rig.pipettes(rig.now())[0].tip_um);
        (view.picture_px([tip[0], tip[1]]).unwrap(), tip[2] - view.focus_um)
    };
    work(&world, |live| {
        live.guard.set_objective(objective);
        let ([x_px, y_px], _) = off();
        let at = Pixel { x_px, y_px };
        let range = (Micrometres(above_um - 40.0), Micrometres(above_um + 40.0));
        live.focus(axis("scope.z"), at, range).unwrap();
        let (_, scanned) = off();
        live.focus_tip(axis("scope.z"), at, range).unwrap();
        (scanned, off().1)
    })
}

#[test]
fn a_tip_is_as_high_through_any_objective() {
    for (objective, starts, within) in [("40x", [-7.0, 9.0], 0.4), ("20x", [-12.0, 11.0], 0.8)] {
        for (seed, above) in (1..).zip(starts) {
            let (scanned, level) = heights(objective, seed, above);
            println!("{objective} from {above} µm: by the peak {scanned:+.2} µm off, by the blur {level:+.2}");
            assert!(level.abs() <= within, "{objective}: {level} µm");
        }
    }
}

#[test]
fn an_objectives_height_is_right_by_a_tip() {
    let world = World::new(model(2, 1.0));
    let truth = world.lock().model().clone();
    let names = vec!["40x".into(), "20x".into()];
    let plan = ObjectivePlan { names, subject: Subject::Tip(m1()), places: 1, seed: 1, focus_within_um: 30.0 };
    let mut recorder = Recorder::memory(Purpose::Microscope);
    let mut turret = |name: &str| if world.lock().set_objective(name) { Ok(()) } else { Err("no such".into()) };
    work(&world, |live| {
        objectives(live, &mut DetectorFinder::default(), &plan, &mut turret, &mut recorder).unwrap();
    });
    let samples: Vec<_> = recorder.samples().iter().filter_map(Sample::objective).collect();
    let a = Matrix2::from_fn(|r, c| truth.camera.matrix_um_per_px[r][c]);
    let options = Options { tolerance_um: None, seed: 1, estimator: Estimator::Robust };
    let found = &fit(&samples, "40x", SENSOR, &a, &options).unwrap()[0];
    let off: Vec<f64> = found.kappa_um.iter().zip(truth.objectives[1].kappa_um).map(|(a, b)| a - b).collect();
    println!("kappa off by {off:.2?} µm");
    assert!(off.iter().all(|off| off.abs() <= 0.8), "{off:?}");
}
