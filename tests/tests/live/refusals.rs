//! What goes wrong at a real rig is refused in words that say what to do, and everything goes back to where it was.

use crate::world::{TruthFinder, TruthFocuser, World, axis, m1, rig_file};
use parfocal::calibration::chain::Pixel;
use parfocal::procedure::{
    CameraPlan, Guard, LiveRig, Parts, ProcedureError, Purpose, Recorder, RegistrationPlan, Subject, camera, coaxial,
    registration, tip_to_pixel,
};
use parfocal::rig::{CameraCalibration, ManipulatorNumber, Obstacle, Registration, Rig};
use parfocal_protocol::units::{Axis, Micrometres};
use parfocal_simulator::model::RigModel;
use parfocal_tests::rig_file::record;

/// The simulated rig's file with its true camera.
fn with_camera() -> Rig {
    let mut rig = rig_file();
    let matrix_um_per_px = RigModel::new(0).camera.matrix_um_per_px;
    rig.set_camera_calibration(CameraCalibration { matrix_um_per_px, objective: None, record: record() }).unwrap();
    rig
}

/// … and its true first manipulator.
fn with_manipulator() -> Rig {
    let mut rig = with_camera();
    let model = RigModel::new(0).manipulators[0];
    let mut matrix = [[0.0, 0.0, 0.0, 0.0], [0.0; 4], [0.0; 4], [0.0, 0.0, 0.0, 1.0]];
    for ((row, joints), origin) in matrix.iter_mut().zip(&model.joints).zip(model.origin_um) {
        row[..3].copy_from_slice(joints);
        row[3] = origin;
    }
    rig.set_registration(m1(), Registration { model: "affine".into(), matrix, record: record() });
    rig
}

struct Ran {
    result: Result<(), ProcedureError>,
    samples: usize,
    /// Every axis is where it was.
    back: bool,
}

fn positions(world: &World) -> Vec<f64> {
    let rig = world.lock();
    let now = rig.now();
    (0..3).flat_map(|board| (0..3).map(move |i| (board, i))).map(|(b, i)| rig.truth(b, Axis(i), now).0).collect()
}

fn register(model: RigModel, rig: &Rig, tune: impl FnOnce(&mut TruthFinder, &mut TruthFocuser), places: usize) -> Ran {
    let world = World::new(model);
    let (mut stage, mut eye) = (world.stage(), world.camera());
    let (mut finder, mut focuser) = (TruthFinder::new(&world, 1), TruthFocuser::new(&world, 1));
    tune(&mut finder, &mut focuser);
    let before = positions(&world);
    let mut recorder = Recorder::memory(Purpose::Registration);
    let plan = RegistrationPlan { manipulator: m1(), places, seed: 1, depth_um: 40.0, focus_within_um: 60.0 };
    let (keep_on, mut silent) = (|| true, |_| {});
    let mut live = LiveRig::new(Parts {
        stage: &mut stage,
        camera: &mut eye,
        focuser: &mut focuser,
        rig,
        keep_on: &keep_on,
        progress: &mut silent,
    })
    .unwrap();
    let result = registration(&mut live, &mut finder, &plan, &mut recorder);
    let back = positions(&world).iter().zip(&before).all(|(a, b)| (a - b).abs() < 0.2);
    Ran { result, samples: recorder.samples().len(), back }
}

#[test]
fn a_tip_lost_from_view_ends_the_procedure_with_what_was_recorded_and_everything_back() {
    let ran = register(RigModel::new(1), &with_camera(), |finder, _| finder.blind_after = 24, 12);
    let error = ran.result.unwrap_err().to_string();
    assert!(error.contains("the tip of m1 is not seen"), "{error}");
    assert!(ran.samples >= 5 && ran.back, "{} samples, back: {}", ran.samples, ran.back);
}

#[test]
fn focus_refused_everywhere_says_the_boards_reason() {
    let ran = register(RigModel::new(1), &with_camera(), |_, focuser| focuser.refuses = 1, 12);
    let error = ran.result.unwrap_err().to_string();
    assert!(error.contains("no significant peak") && ran.back && ran.samples == 0, "{error}");
}

#[test]
fn a_manipulator_at_its_limit_is_told_by_its_axis() {
    let mut model = RigModel::new(1);
    model.set_limits(1, Axis(1), Micrometres(-1.0), Micrometres(1.0));
    let ran = register(model, &with_camera(), |_, _| {}, 12);
    let error = ran.result.unwrap_err().to_string();
    assert!(error.contains("m1.y") && error.contains("may only go from -1 to 1") && ran.back, "{error}");
}

#[test]
fn what_is_not_known_yet_is_named_before_anything_moves() {
    let ran = register(RigModel::new(1), &rig_file(), |_, _| {}, 12);
    assert!(ran.result.unwrap_err().to_string().contains("calibrate camera"));
    let mut rig = with_camera();
    rig.set_objective_in_use(None).unwrap();
    let ran = register(RigModel::new(1), &rig, |_, _| {}, 12);
    assert!(ran.result.unwrap_err().to_string().contains("parfocal objective NAME"));
}

#[test]
fn an_obstacle_around_a_registration_is_kept_clear_of_and_one_in_the_way_is_named() {
    let world = World::new(RigModel::new(1));
    let tip = world.tip(0);
    // A floor just below: places above it are drawn instead.
    let mut rig = with_camera();
    rig.contents_mut().obstacles.push(Obstacle::Floor { name: "dish".into(), z_um: tip[2] - 17.0 });
    let ran = register(RigModel::new(1), &rig, |_, _| {}, 12);
    assert!(ran.result.is_ok() && ran.back, "{:?}", ran.result);
    // A floor at the tip itself: no joint has room.
    rig.contents_mut().obstacles[0] = Obstacle::Floor { name: "dish".into(), z_um: tip[2] - 2.0 };
    let error = register(RigModel::new(1), &rig, |_, _| {}, 12).result.unwrap_err().to_string();
    assert!(error.contains("dish"), "{error}");
}

#[test]
fn a_camera_of_another_size_is_told_by_its_keys() {
    let world = World::new(RigModel::new(1));
    let (mut stage, mut eye) = (world.stage(), world.camera());
    let mut focuser = TruthFocuser::new(&world, 1);
    let mut rig = rig_file();
    if let Some(camera) = rig.contents_mut().camera.as_mut() {
        camera.binning = 2;
    }
    let parts = Parts {
        stage: &mut stage,
        camera: &mut eye,
        focuser: &mut focuser,
        rig: &rig,
        keep_on: &|| true,
        progress: &mut |_| {},
    };
    let error = LiveRig::new(parts).err().unwrap().to_string();
    assert!(error.contains("640x480") && error.contains("320x240") && error.contains("camera.width_px"), "{error}");
}

#[test]
fn a_point_that_does_not_move_in_the_picture_is_no_point_of_the_world() {
    struct Dirt;
    impl parfocal::procedure::PointFinder for Dirt {
        fn find(
            &mut self,
            _: &parfocal::frames::camera::Frame,
            _: &parfocal::procedure::Hint,
        ) -> Result<parfocal::procedure::Found, parfocal::procedure::NotFound> {
            let at = parfocal::procedure::FramePixel { x_px: 300.0, y_px: 200.0 };
            let by = parfocal::procedure::Witness::Detector;
            Ok(parfocal::procedure::Found { at, confidence: 1.0, angle_deg: None, by })
        }
    }
    let world = World::new(RigModel::new(1));
    let (mut stage, mut eye) = (world.stage(), world.camera());
    let mut focuser = TruthFocuser::new(&world, 1);
    let rig = rig_file();
    let (keep_on, mut silent) = (|| true, |_| {});
    let mut live = LiveRig::new(Parts {
        stage: &mut stage,
        camera: &mut eye,
        focuser: &mut focuser,
        rig: &rig,
        keep_on: &keep_on,
        progress: &mut silent,
    })
    .unwrap();
    let plan = CameraPlan { subject: Subject::Point("dirt".into()), places: 6, seed: 1, focus_within_um: None };
    let mut recorder = Recorder::memory(Purpose::Microscope);
    let error = camera(&mut live, &mut Dirt, &plan, &mut recorder).unwrap_err().to_string();
    assert!(error.contains("scope.x") && error.contains("point 'dirt'"), "{error}");
}

#[test]
fn a_guarded_move_is_refused_before_anything_moves() {
    let world = World::new(RigModel::new(1));
    let mut stage = world.stage();
    let mut rig = with_manipulator();
    let tip = world.tip(0);
    // A thin wall beside the tip; both ends of the move are free.
    let (min_um, max_um) = ([tip[0] + 20.0, -1e4, -1e4], [tip[0] + 20.5, 1e4, 1e4]);
    rig.contents_mut().obstacles.push(Obstacle::Box { name: "wall".into(), min_um, max_um });
    let before = positions(&world);
    let keep_on = || true;
    let mut guard = Guard::new(&mut stage, &rig, &keep_on);
    let pose = guard.pose().unwrap();
    let right = Pixel { x_px: 320.0 + (tip[0] + 60.0) / 0.323, y_px: 240.0 };
    let targets = tip_to_pixel(&rig, &pose, m1(), right, Micrometres(-40.0)).unwrap();
    let error = guard.move_to(&targets).unwrap_err().to_string();
    assert!(error.contains("'wall'") && error.contains("m1"), "{error}");
    assert_eq!(positions(&world), before);
    // Beyond a soft limit: the axis and its limits.
    let error = guard.move_to(&[(axis("m1.x"), Micrometres(2e4))]).unwrap_err().to_string();
    assert!(error.contains("m1.x may only go from -10000 to 10000"), "{error}");
    // A manipulator whose tip nobody knows does not move among obstacles.
    let error = guard.move_to(&[(axis("m2.x"), Micrometres(5.0))]).unwrap_err().to_string();
    assert!(error.contains("m2") && error.contains("not registered"), "{error}");
    assert_eq!(positions(&world), before);
    // Without a direction of the pipette there is no coaxial move.
    let error = coaxial(&rig, &pose, m1(), Micrometres(5.0)).unwrap_err().to_string();
    assert!(error.contains("calibrate pipette"), "{error}");
    let m2 = ManipulatorNumber::new(2).unwrap();
    let error = tip_to_pixel(&rig, &pose, m2, right, Micrometres(0.0)).unwrap_err().to_string();
    assert!(error.contains("m2 is not registered"), "{error}");
}
