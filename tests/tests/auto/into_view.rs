//! A tip brought into view from where markers have it to where it is, through a 4x and a 40x objective.

use crate::rendered::Rendered;
use crate::world::{Noise, World, rig_file};
use parfocal::focus::Measure;
use parfocal::procedure::{
    DetectorFinder, InView, IntoViewPlan, LiveRig, Parts, ProcedureError, Progress, Purpose, Recorder, ScanFocuser,
    into_view,
};
use parfocal::rig::{CameraCalibration, CoarseRegistration, ManipulatorNumber, Pipette, Record, Rig, Zoom};
use parfocal_simulator::model::{ManipulatorModel, ObjectiveModel, RigModel};
use parfocal_simulator::rig;
use parfocal_tests::rig_file::record;

const DATE: &str = "2026-11-25T00:00:00Z";
/// What the coarse registrations here say of their own error.
const ERROR_UM: f64 = 120.0;
const ERROR_DEG: f64 = 0.3;

fn one() -> ManipulatorNumber {
    ManipulatorNumber::new(1).unwrap()
}

/// The rig's file with camera and objectives calibrated.
pub fn calibrated_microscope(rig: &rig::Rig) -> Rig {
    let mut file = rig_file();
    let record = Record { date: DATE.into(), ..record() };
    let matrix_um_per_px = rig.model().camera.matrix_um_per_px;
    file.set_camera_calibration(CameraCalibration { matrix_um_per_px, objective: None, record }).unwrap();
    for objective in &rig.model().objectives {
        let zoom = Zoom { zoom: 1.0, alpha: objective.alpha, kappa_um: objective.kappa_um, record: None };
        file.set_zoom(objective.name, zoom);
        let entry = file.contents_mut().objectives.get_mut(objective.name).unwrap();
        entry.depth_of_field_um = Some(objective.depth_of_field_um);
    }
    file
}

/// The first manipulator's coarse registration, wrong by so much.
fn place(file: &mut Rig, m: &ManipulatorModel, off_um: [f64; 3], off_deg: [f64; 2]) {
    let mut matrix = [[0.0, 0.0, 0.0, 1.0]; 4];
    for (k, (row, joints)) in matrix.iter_mut().zip(m.joints).enumerate() {
        row[..3].copy_from_slice(&joints);
        row[3] = m.origin_um[k] + off_um[k];
    }
    let (error_um, error_deg, date) = (ERROR_UM, ERROR_DEG, DATE.to_owned());
    let registration = CoarseRegistration { matrix, error_um, error_deg, joints_um: [0.0; 3], date: date.clone() };
    let [descent_deg, azimuth_deg] =
        [m.descent_rad + off_deg[0].to_radians(), m.azimuth_rad + off_deg[1].to_radians()].map(f64::to_degrees);
    let pipette = Pipette { descent_deg, azimuth_deg, source: parfocal::rig::MARKERS.into(), date };
    file.set_coarse(one(), registration, Some(pipette));
}

/// Looks for a tip through 4x, then 40x, as they really show it.
fn search(world: &World, file: &Rig, manipulator: ManipulatorNumber) -> Result<InView, ProcedureError> {
    let plan = IntoViewPlan { manipulator, objectives: vec!["4x".into(), "40x".into()] };
    let mut focuser = ScanFocuser::new(Measure::Tenengrad, 100 * u16::from(manipulator.get()));
    let (mut camera, mut progress) = (Rendered(world.clone()), |p: Progress| println!("{p:?}"));
    let mut stage = world.stage();
    let mut live = LiveRig::new(Parts {
        stage: &mut stage,
        camera: &mut camera,
        focuser: &mut focuser,
        rig: file,
        keep_on: &|| true,
        progress: &mut progress,
    })
    .unwrap();
    let mut turret = |name: &str| if world.lock().set_objective(name) { Ok(()) } else { Err("no such".into()) };
    let recorder = &mut Recorder::memory(Purpose::Registration);
    let found = into_view(&mut live, &mut DetectorFinder::default(), &plan, &mut turret, recorder);
    stage.close();
    found
}

/// Brings a tip into view, and sees that it is there.
fn bring(world: &World, file: &Rig, manipulator: ManipulatorNumber) {
    let found = search(world, file, manipulator).unwrap();
    let tip = world.tip(usize::from(manipulator.get()) - 1);
    let shown = world.shown(found.seen.pixel.x_px, found.seen.pixel.y_px);
    let focus = {
        let rig = world.lock();
        rig.viewpoint(rig.now()).focus_um
    };
    let (aside, above) = ((tip[0] - shown[0]).hypot(tip[1] - shown[1]), tip[2] - focus);
    println!("{manipulator}: seen {aside:.2} µm aside, {above:.2} µm above focus; {:?}", found.correction);
    // The detector sees tips to a pixel or two; the blur of the glass tells the height to a fraction of a depth of field.
    assert!(aside < 1.0 && above.abs() < 1.5, "{manipulator}: {aside} µm aside, {above} µm above focus");
}

/// Coarse registrations as wrong as they say they may be, drawn anew each time, and pipettes of every steepness.
fn wherever_it_really_is(seeds: std::ops::Range<u64>) {
    for seed in seeds {
        let mut noise = Noise::new(seed);
        let mut model = RigModel::new(seed);
        model.objectives.push(ObjectiveModel::SEARCHER);
        let steepness = 25.0 + 35.0 * noise.uniform();
        model.manipulators[0].descent_rad = f64::to_radians(steepness);
        let world = World::new(model.clone());
        let mut file = calibrated_microscope(&world.lock());
        let off_um: [f64; 3] = std::array::from_fn(|_| ERROR_UM * noise.normal().clamp(-2.5, 2.5));
        let off_deg = [0, 1].map(|_| ERROR_DEG * noise.normal());
        place(&mut file, &model.manipulators[0], off_um, off_deg);
        println!("seed {seed}: {steepness:.0}° down, wrong by {off_um:?} µm, {off_deg:?}°");
        bring(&world, &file, one());
    }
}

#[test]
fn a_tip_is_found_wherever_it_really_is() {
    wherever_it_really_is(0..3);
}

/// `cargo nextest run -p parfocal-tests --test auto --run-ignored only thirty --no-capture`
#[test]
#[ignore = "thirty runs: minutes; the same as the one above, which CI plays with three"]
fn a_tip_is_found_wherever_it_really_is_thirty_times() {
    wherever_it_really_is(100..130);
}

#[test]
fn a_manipulator_that_was_moved_since_is_said_to_be_nowhere_and_goes_back() {
    let mut model = RigModel::new(7);
    model.objectives.push(ObjectiveModel::SEARCHER);
    let world = World::new(model.clone());
    let mut file = calibrated_microscope(&world.lock());
    // The pipette comes from −x and lies on the far side of where it should be: no shank leads to its tip.
    place(&mut file, &model.manipulators[0], [2500.0, 2500.0, 0.0], [0.0, 0.0]);
    let before = world.tip(0);
    let missing = search(&world, &file, one());
    let Err(ProcedureError::Nowhere { .. }) = &missing else { panic!("{missing:?}") };
    assert!(missing.unwrap_err().to_string().contains("'parfocal calibrate coarse"));
    let after = world.tip(0);
    assert!((0..3).all(|k| (before[k] - after[k]).abs() < 0.5), "{before:?} {after:?}");
}

#[test]
fn without_a_coarse_registration_it_says_how_to_get_one() {
    let world = World::new(RigModel::new(1));
    let (mut stage, file, keep_on) = (world.stage(), rig_file(), || true);
    let (mut camera, mut focuser) = (Rendered(world.clone()), ScanFocuser::new(Measure::Tenengrad, 1));
    let mut progress = |_| {};
    let mut live = LiveRig::new(Parts {
        stage: &mut stage,
        camera: &mut camera,
        focuser: &mut focuser,
        rig: &file,
        keep_on: &keep_on,
        progress: &mut progress,
    })
    .unwrap();
    let plan = IntoViewPlan { manipulator: ManipulatorNumber::new(2).unwrap(), objectives: vec!["40x".into()] };
    let (finder, recorder) = (&mut DetectorFinder::default(), &mut Recorder::memory(Purpose::Registration));
    let refused = into_view(&mut live, finder, &plan, &mut |_| Ok(()), recorder);
    let Err(ProcedureError::Uncoarse(_)) = &refused else { panic!("{refused:?}") };
    assert!(refused.unwrap_err().to_string().contains("calibrate coarse"));
}
