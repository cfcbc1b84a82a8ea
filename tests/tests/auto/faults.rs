//! What goes wrong at a real rig: the run goes on without that sample, or stops with what is missing. Nothing recorded is lost.

use crate::eyes::{Wrongs, both, faulty, run};
use crate::world::{World, m1, rig_file};
use parfocal::autonomous::{AutoError, Plan};
use parfocal::rig::{ManipulatorNumber, Obstacle};
use parfocal_protocol::units::{Axis, Micrometres};

fn rows(folder: &std::path::Path, name: &str) -> usize {
    let text = std::fs::read_to_string(folder.join(name)).unwrap_or_default();
    text.lines().filter(|line| !line.starts_with('#')).count().saturating_sub(1)
}

#[test]
fn a_missing_pipette_is_named_and_the_other_manipulator_is_calibrated() {
    let world = World::new(faulty(3));
    let mut rig = rig_file();
    let wrongs = Wrongs { missing: vec![1], ..Wrongs::default() };
    let done = run(&world, &mut rig, 3, &wrongs, &Plan::new(both(), 3)).result.unwrap();
    let [(n, why)] = &done.missing[..] else { panic!("{:?}", done.missing) };
    assert!(n.get() == 2 && matches!(why, AutoError::NotMoving { .. } | AutoError::NoTip { .. }), "{why}");
    assert!(why.to_string().contains("broken or missing"), "{why}");
    assert!(rig.contents().manipulators[&m1()].registration.is_some());
}

#[test]
fn what_only_looks_like_a_tip_is_passed_over() {
    let world = World::new(faulty(4));
    let mut rig = rig_file();
    // The surest 'tip' in every picture: dirt on the sensor.
    let wrongs = Wrongs { stray_tip: Some([500.0, 100.0]), missing: vec![1], ..Wrongs::default() };
    let ran = run(&world, &mut rig, 4, &wrongs, &Plan::new(both(), 4));
    let done = ran.result.unwrap_or_else(|error| panic!("{error}; said {:?}", ran.said));
    let [(n, why)] = &done.missing[..] else { panic!("{:?}", done.missing) };
    assert!(n.get() == 2 && matches!(why, AutoError::NotMoving { .. }), "{why}");
    assert!(ran.said.iter().any(|text| text.contains("not focused")), "{:?}", ran.said);
    assert!(rig.contents().manipulators[&m1()].registration.is_some());
}

#[test]
fn a_tip_is_looked_for_beyond_those_that_are_nearer_to_focus() {
    let mut model = faulty(14);
    // The microscope begins at 40 µm, where the second pipette's tip is; the first one's is 40 µm below.
    model.manipulators[1].origin_um[2] = 40.0;
    let world = World::new(model);
    let mut rig = rig_file();
    let ran = run(&world, &mut rig, 14, &Wrongs::default(), &Plan::new(both(), 14));
    let done = ran.result.unwrap_or_else(|error| panic!("{error}; said {:?}", ran.said));
    assert!(done.missing.is_empty(), "{:?}; said {:?}", done.missing, ran.said);
}

#[test]
fn two_tips_on_one_manipulator_are_named_and_the_other_manipulator_is_calibrated() {
    let world = World::new(faulty(9));
    let mut rig = rig_file();
    let wrongs = Wrongs { second_tip: Some((0, [50.0, 30.0])), ..Wrongs::default() };
    let done = run(&world, &mut rig, 9, &wrongs, &Plan::new(both(), 9)).result.unwrap();
    let [(n, why)] = &done.missing[..] else { panic!("{:?}", done.missing) };
    assert!(n.get() == 1 && matches!(why, AutoError::SeveralMove { seen: 2, .. }), "{why}");
    assert!(rig.contents().manipulators[&ManipulatorNumber::new(2).unwrap()].registration.is_some());
}

#[test]
fn a_pipette_that_breaks_on_the_way_costs_its_manipulator_only() {
    let world = World::new(faulty(10));
    let mut rig = rig_file();
    let folder = tempfile::tempdir().unwrap();
    let plan = Plan { folder: Some(folder.path().into()), ..Plan::new(both(), 10) };
    // While the first manipulator is being looked at: the camera takes some 40 frames.
    let wrongs = Wrongs { breaks: Some((0, 50)), ..Wrongs::default() };
    let ran = run(&world, &mut rig, 10, &wrongs, &plan);
    let done = ran.result.unwrap_or_else(|error| panic!("{error}; said {:?}", ran.said));
    let [(n, why)] = &done.missing[..] else { panic!("{:?} after {} frames", done.missing, ran.frames) };
    assert!(n.get() == 1 && matches!(why, AutoError::Lost { .. } | AutoError::Procedure(_)), "{why:?}");
    assert!(rows(folder.path(), "m1.csv") > 0 && rows(folder.path(), "camera.csv") >= 8);
    assert!(rig.contents().manipulators[&ManipulatorNumber::new(2).unwrap()].registration.is_some());
}

#[test]
fn when_the_light_goes_out_it_stops_and_a_second_run_goes_on_from_its_samples() {
    let world = World::new(faulty(5));
    let mut rig = rig_file();
    let folder = tempfile::tempdir().unwrap();
    let plan = Plan { folder: Some(folder.path().into()), ..Plan::new(vec![m1()], 5) };
    let dark = Wrongs { dark_after: Some(90), ..Wrongs::default() };
    let ran = run(&world, &mut rig, 5, &dark, &plan);
    let why = match ran.result {
        Ok(done) => done.missing.into_iter().map(|(_, e)| e.to_string()).collect(),
        Err(error) => error.to_string(),
    };
    assert!(why.contains("dark"), "{why}");
    let kept = rows(folder.path(), "camera.csv") + rows(folder.path(), "m1.csv");
    assert!(kept > 8, "{kept}");
    let again = run(&world, &mut rig, 5, &Wrongs::default(), &plan);
    assert!(again.result.unwrap().missing.is_empty());
    assert!(rig.contents().manipulators[&m1()].registration.is_some());
    // The camera's samples were enough: none was taken again.
    assert!(again.frames > 0 && rows(folder.path(), "camera.csv") < 60);
    assert!(!folder.path().join("camera-2.csv").exists());
}

#[test]
fn a_stop_on_request_keeps_what_was_recorded() {
    let world = World::new(faulty(6));
    let mut rig = rig_file();
    let folder = tempfile::tempdir().unwrap();
    let plan = Plan { folder: Some(folder.path().into()), ..Plan::new(vec![m1()], 6) };
    let wrongs = Wrongs { stop_after: Some(160), ..Wrongs::default() };
    let error = run(&world, &mut rig, 6, &wrongs, &plan).result.unwrap_err();
    assert!(error.to_string().contains("stopped on request"), "{error}");
    let before = rows(folder.path(), "camera.csv") + rows(folder.path(), "m1.csv");
    assert!(before > 0);
    // As if the power had gone in the middle of a line.
    let path = folder.path().join("camera.csv");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, format!("{text}2026-11-25T00:00:00Z,40x,1,tip,3.0")).unwrap();
    assert!(run(&world, &mut rig, 6, &Wrongs::default(), &plan).result.unwrap().missing.is_empty());
}

#[test]
fn refused_focus_and_a_manipulator_at_its_limit_cost_samples_only() {
    let mut model = faulty(7);
    // The first manipulator's x ends 20 µm from where it is.
    model.set_limits(1, Axis(0), Micrometres(-500.0), Micrometres(20.0));
    let world = World::new(model);
    let mut rig = rig_file();
    let wrongs = Wrongs { refuses: 6, astray: 0.1, ..Wrongs::default() };
    let ran = run(&world, &mut rig, 7, &wrongs, &Plan::new(vec![m1()], 7));
    assert!(ran.result.as_ref().is_ok_and(|done| done.missing.is_empty()), "{:?} {:?}", ran.result, ran.said);
    assert!(ran.said.iter().any(|text| text.contains("not focused")), "{:?}", ran.said);
}

#[test]
fn no_tip_is_ever_driven_below_the_floor() {
    let world = World::new(faulty(8));
    let mut rig = rig_file();
    // The tips of the two start at 0 and 6 µm; places reach 60 µm below them.
    rig.contents_mut().obstacles.push(Obstacle::Floor { name: "dish".into(), z_um: -40.0 });
    let plan = Plan { depth_um: 120.0, ..Plan::new(both(), 8) };
    let ran = run(&world, &mut rig, 8, &Wrongs { astray: 0.1, ..Wrongs::default() }, &plan);
    assert!(ran.result.as_ref().is_ok_and(|done| done.missing.is_empty()), "{:?} {:?}", ran.result, ran.said);
    assert!(ran.lowest_um > -40.0 && ran.lowest_um < -10.0, "{}", ran.lowest_um);
}
