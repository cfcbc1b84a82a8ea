//! From stereo pictures of printed markers to both tips in the picture of a 40x objective, and on to both manipulators' fine
//! calibration, and nobody helps.

use crate::eyes::both;
use crate::into_view::calibrated_microscope;
use crate::rendered::Rendered;
use crate::unattended::send_to_random_pixels;
use crate::world::World;
use nalgebra::{Matrix3, Point3, Vector3};
use parfocal::autonomous::{DetectorEyes, Plan, Turret, Work, calibrate};
use parfocal::calibration::coarse::edges::Grey;
use parfocal::calibration::coarse::learn::fine::{self, Fine, Objective};
use parfocal::calibration::coarse::learn::{Learned, Now, moves, place};
use parfocal::calibration::coarse::marker::{CELLS, cells};
use parfocal::calibration::coarse::{Degrees, MarkerId, Pair, Place, Registration, Settings, StereoCamera, register};
use parfocal::focus::Measure;
use parfocal::procedure::{DetectorFinder, Guard, Progress, ScanFocuser, tips};
use parfocal::rig::{AxisName, CoarseRegistration, Coordinate, Device, ManipulatorNumber, Pipette, Rig};
use parfocal_protocol::units::{Axis, Micrometres};
use parfocal_simulator::model::{ManipulatorModel, ObjectiveModel, RigModel};
use parfocal_simulator::rig;
use parfocal_simulator::stereo::{self, Finish, Pose, Print, Scene, bench};
use std::collections::BTreeMap;

const DATE: &str = "2026-11-25T00:00:00Z";
/// On manipulators 1 and 2.
const MARKERS: [MarkerId; 2] = [MarkerId(1), MarkerId(2)];
const OBJECTIVE: MarkerId = MarkerId(3);

fn stereo_camera(pair: &bench::Pair) -> StereoCamera {
    let lens = |l: &stereo::Lens| {
        let [k1, k2, p1, p2] = l.distortion;
        serde_json::json!({"fx": l.fx, "fy": l.fy, "cx": l.cx, "cy": l.cy, "k1": k1, "k2": k2, "p1": p1, "p2": p2})
    };
    let file = serde_json::json!({
        "image_size": [pair.size.0, pair.size.1],
        "left": lens(&pair.lenses[0]), "right": lens(&pair.lenses[1]),
        "R": pair.left_to_right.rotation, "t_m": pair.left_to_right.translation.map(|v| v / 1000.0),
    });
    StereoCamera::from_json(&file.to_string()).unwrap()
}

/// The markers placed by what the stereo camera sees of the rig from two places.
fn photograph(rig: &rig::Rig, seed: u64) -> Registration {
    let pair = bench::Pair::new();
    let print = |(id, pose): (u16, Pose)| Print {
        white: cells(MarkerId(id)).unwrap().concat(),
        cells: CELLS,
        cell_mm: bench::TAG_MM / 8.0,
        pose,
    };
    let scene = Scene { prints: bench::markers(rig).into_iter().map(print).collect(), occluders: Vec::new() };
    let take = |place: &Pose, side: usize, seed: u64| {
        let pose = if side == 0 { *place } else { pair.left_to_right.after(place) };
        let camera = stereo::Camera { lens: pair.lenses[side], pose, size: pair.size };
        let values = stereo::render(&scene, &camera, &Finish::default(), seed).into_iter().map(f32::from).collect();
        Grey { width: pair.size.0, height: pair.size.1, values }
    };
    let pairs: Vec<Pair> = (1..)
        .zip(&bench::places(seed))
        .map(|(k, place)| Pair {
            place: Place(k),
            left: take(place, 0, 100 * seed + 2 * u64::from(k)),
            right: take(place, 1, 100 * seed + 2 * u64::from(k) + 1),
        })
        .collect();
    let settings = Settings::new(bench::TAG_MM, MarkerId(bench::SUBSTRATE));
    let found = register(&pairs, &stereo_camera(&pair), &settings).unwrap();
    assert!(found.rejected.is_empty() && found.markers.len() == 4, "{:?}", found.rejected);
    found
}

fn position(rig: &rig::Rig, board: usize) -> Vector3<f64> {
    Vector3::from([0, 1, 2].map(|axis| rig.truth(board, Axis(axis), rig.now()).0))
}

/// The day on which all was calibrated: what the markers carry.
fn learn(model: &RigModel, seed: u64) -> Learned {
    let mut stops: BTreeMap<MarkerId, Vec<moves::Stop>> = BTreeMap::new();
    let mut objective = None;
    for (k, moved) in [[0.0; 3], [5000.0, 0.0, 0.0], [0.0, 5000.0, 0.0]].into_iter().enumerate() {
        let mut model = model.clone();
        for board in [1, 2] {
            for (axis, at) in (0..3).zip(moved) {
                model.set_position(board, Axis(axis), Micrometres(at));
            }
        }
        let rig = rig::Rig::new(model);
        let seen = photograph(&rig, seed + k as u64);
        let pose = seen.markers[&OBJECTIVE];
        objective.get_or_insert(Objective { marker: OBJECTIVE, pose, microscope_um: position(&rig, 0) });
        for (n, id) in MARKERS.into_iter().enumerate() {
            let tip = Point3::from(bench::from_ref(rig.pipettes(rig.now())[n].tip_um));
            stops.entry(id).or_default().push(moves::Stop {
                joints_um: position(&rig, n + 1),
                marker: seen.markers[&id].pose,
                // Clicked once, a tenth of a millimetre or two off.
                tip_mm: (k == 0).then(|| tip + Vector3::new(0.08, -0.06, 0.12)),
                shank_mm: None,
            });
        }
    }
    let fine = |m: &ManipulatorModel| Fine {
        axes: Matrix3::from_fn(|r, c| m.joints[r][c]),
        origin_um: Vector3::from(m.origin_um),
        pipette: Some([m.descent_rad, m.azimuth_rad].map(|a| Degrees(a.to_degrees()))),
    };
    let all = stops.into_iter().zip(&model.manipulators).map(|((id, stops), m)| (id, (fine(m), stops))).collect();
    fine::learn(&all, objective.as_ref()).unwrap()
}

/// The rig's file: camera and objectives calibrated on the first day, markers photographed today.
fn file_of(world: &World, learned: &Learned, seed: u64) -> Rig {
    let rig = world.lock();
    let mut file = calibrated_microscope(&rig);
    let joints_um = MARKERS.into_iter().enumerate().map(|(n, id)| (id, position(&rig, n + 1))).collect();
    let now = Now { microscope_um: position(&rig, 0), joints_um };
    let placed = place(&photograph(&rig, seed), learned, &now).unwrap();
    for (n, id) in MARKERS.into_iter().enumerate() {
        let (coarse, truth) = (&placed[&id], rig.pipettes(rig.now())[n]);
        let off = (Vector3::from(coarse.tip_um.unwrap()) - Vector3::from(truth.tip_um)).norm();
        let (theta, psi) = (coarse.theta.unwrap(), coarse.psi.unwrap());
        println!("marker {id}: tip {off:.0} µm off, {} expected; {theta} down, {psi} around", coarse.tip_error);
        assert!((theta.0 - truth.descent_rad.to_degrees()).abs() <= 0.5 && off < 600.0, "{theta}, {off} µm");
        let [a, b, c] = coarse.man_to_ref_um;
        let registration = CoarseRegistration {
            matrix: [a, b, c, [0.0, 0.0, 0.0, 1.0]],
            error_um: coarse.tip_error.0 * 1000.0,
            error_deg: coarse.direction_error.0,
            joints_um: position(&rig, n + 1).into(),
            date: DATE.into(),
        };
        let source = parfocal::rig::MARKERS.into();
        let pipette = Pipette { descent_deg: theta.0, azimuth_deg: psi.0, source, date: DATE.into() };
        file.set_coarse(ManipulatorNumber::new(n as u8 + 1).unwrap(), registration, Some(pipette));
    }
    file
}

/// Both tips brought into view and calibrated, one after the other, by rendered frames, the tip detector and the boards' own scans.
fn calibrate_all(world: &World, file: &mut Rig) {
    let (mut stage, mut camera) = (world.stage(), Rendered(world.clone()));
    let mut focuser = ScanFocuser::new(Measure::Tenengrad, 9);
    let mut progress = |p: Progress| {
        if let Progress::Begins(said) | Progress::Passed(said) | Progress::Warning(said) = p {
            println!("{said}");
        }
    };
    let mut change = |name: &str| if world.lock().set_objective(name) { Ok(()) } else { Err("no such".into()) };
    let through = ["4x".to_owned(), "40x".to_owned()];
    let mut finder = DetectorFinder::default();
    let mut work = Work {
        stage: &mut stage,
        camera: &mut camera,
        focuser: &mut focuser,
        eyes: &mut DetectorEyes::default(),
        keep_on: &|| true,
        progress: &mut progress,
        turret: Some(Turret { through: &through, change: &mut change, finder: &mut finder }),
    };
    let done = calibrate(&mut work, file, &Plan::new(both(), 4), &|| DATE.into(), &mut |_| Ok(())).unwrap();
    stage.close();
    println!("{:#?}, {:.1} min of the rig's time", done.done, world.lock().now() as f64 / 60e6);
    assert!(done.missing.is_empty(), "{:?}", done.missing);
}

/// Moves the microscope to where a tip is by its registration.
fn look_at(world: &World, file: &Rig, n: ManipulatorNumber) {
    let mut stage = world.stage();
    let keep_on = || true;
    let mut guard = Guard::new(&mut stage, file, &keep_on);
    let tip = tips(file, &guard.pose().unwrap()).into_iter().find(|tip| tip.manipulator == n).unwrap();
    let [x, y, z] = tip.ref_um.unwrap();
    let to = Coordinate::ALL.map(|coordinate| AxisName { device: Device::Scope, coordinate });
    guard.move_to(&to.into_iter().zip([x, y, z].map(Micrometres)).collect::<Vec<_>>()).unwrap();
    stage.close();
}

#[test]
fn from_markers_to_both_tips_in_view_to_the_fine_calibration() {
    let seed = 3;
    let mut model = RigModel::new(seed);
    model.objectives.push(ObjectiveModel::SEARCHER);
    let learned = learn(&model, seed);
    // Another day: both manipulators were set down anew.
    let moved = [[900.0, -700.0, 500.0], [-1100.0, 400.0, 350.0]];
    for (m, by) in model.manipulators.iter_mut().zip(moved) {
        m.origin_um.iter_mut().zip(by).for_each(|(o, by)| *o += by);
    }
    let world = World::new(model);
    let mut file = file_of(&world, &learned, seed + 20);
    calibrate_all(&world, &mut file);
    // Each where it was calibrated: the tips are 2 mm apart, and a thousandth of that is more than is allowed.
    for n in both() {
        look_at(&world, &file, n);
        let worst = send_to_random_pixels(&world, &file, n, 5);
        println!("{n}: {worst:.2} µm at worst");
        assert!(worst <= 1.5, "{n}: {worst:.2} µm");
    }
}
