//! The commands a newcomer types: the simulated rig set up, calibrated live with the tip detector, and used.

use parfocal_protocol::units::Axis;
use parfocal_simulator::model::RigModel;
use parfocal_simulator::rig::Rig;
use parfocal_tests::parfocal_json;
use serde_json::Value;
use std::path::{Path, PathBuf};

struct Folder {
    folder: tempfile::TempDir,
}

impl Folder {
    fn new() -> Self {
        let folder = Self { folder: tempfile::tempdir().unwrap() };
        let out = folder.rig();
        let (code, said) = parfocal_json(&["setup", "--simulated", "--out", out.to_str().unwrap()]);
        assert_eq!(code, 0, "{said}");
        folder
    }

    fn rig(&self) -> PathBuf {
        self.folder.path().join("rig.toml")
    }

    fn text(&self) -> String {
        std::fs::read_to_string(self.rig()).unwrap()
    }

    fn run(&self, arguments: &[&str]) -> (i32, Value) {
        let rig = self.rig();
        parfocal_json(&[arguments, &["--rig", rig.to_str().unwrap()]].concat())
    }

    fn refusal(&self, arguments: &[&str]) -> String {
        let (code, said) = self.run(arguments);
        assert_eq!(code, 1, "{said}");
        said["error"].as_str().unwrap().into()
    }

    /// The world as the last command left it, from what the simulated rig remembers.
    fn world(&self, objective: &str) -> Rig {
        let text = std::fs::read_to_string(self.folder.path().join("rig.simulated.toml")).unwrap();
        let mut model = RigModel::new(0);
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            let (name, at) = line.split_once(" = ").unwrap();
            let (device, coordinate) = name.trim_matches('"').split_once('.').unwrap();
            let board = ["scope", "m1", "m2"].iter().position(|d| *d == device).unwrap();
            let axis = ["x", "y", "z"].iter().position(|c| *c == coordinate).unwrap();
            model.set_position(board, Axis(axis as u8), parfocal_protocol::units::Micrometres(at.parse().unwrap()));
        }
        let mut rig = Rig::new(model);
        assert!(rig.set_objective(objective));
        rig
    }
}

fn samples_in(folder: &Path) -> usize {
    std::fs::read_dir(folder)
        .unwrap()
        .filter(|e| e.as_ref().unwrap().path().extension().is_some_and(|e| e == "csv"))
        .count()
}

#[test]
fn a_newcomer_calibrates_the_simulated_rig_and_sends_a_tip_to_a_pixel() {
    let here = Folder::new();
    let (code, camera) = here.run(&["calibrate", "camera", "--places", "6"]);
    assert_eq!(code, 0, "{camera}");
    let truth = RigModel::new(0).camera.matrix_um_per_px;
    for (r, row) in truth.iter().enumerate() {
        for (c, a) in row.iter().enumerate() {
            let found = camera["matrix_um_per_px"][r][c].as_f64().unwrap();
            assert!((found - a).abs() < 0.01 * 0.32, "{camera}");
        }
    }
    let (code, registration) = here.run(&["calibrate", "registration", "--manipulator", "1", "--places", "6"]);
    assert_eq!(code, 0, "{registration}");
    // Vertical axis and approach axis stand 59.7° apart in the simulated manipulator: 180° − 59.7° by their directions.
    let zx = registration["axis_angles_deg"]["zx"].as_f64().unwrap();
    assert!((zx - 120.3).abs() < 3.0, "{registration}");
    assert_eq!(samples_in(here.folder.path()), 2);

    let (code, went) = here.run(&["goto", "--manipulator", "1", "--pixel", "250,180"]);
    assert_eq!((code, went["moved"].as_bool()), (0, Some(true)), "{went}");
    let expected = went["expected_error_um"].as_f64().unwrap();
    assert!(expected > 0.0 && expected < 1.0, "{went}");
    let world = here.world("40x");
    let (tip, wanted) = (world.pipettes(0)[0].tip_um, world.viewpoint(0).ref_um(250.0, 180.0));
    let off = (tip[0] - wanted[0]).hypot(tip[1] - wanted[1]);
    assert!(off <= 1.5, "{off} µm off");
    let (_, places) = here.run(&["where"]);
    let pixel = &places["tips"][0]["pixel"];
    assert!((pixel[0].as_f64().unwrap() - 250.0).abs() < 0.5 && (pixel[1].as_f64().unwrap() - 180.0).abs() < 0.5);

    // Along its own axis, and back.
    let (code, _) = here.run(&["calibrate", "pipette", "--manipulator", "1", "--axis", "x"]);
    assert_eq!(code, 0);
    let before = here.world("40x").pipettes(0)[0].tip_um;
    assert_eq!(here.run(&["coaxial", "--manipulator", "1", "-40"]).0, 0);
    let after = here.world("40x").pipettes(0)[0].tip_um;
    let moved: f64 = (0..3).map(|k| (after[k] - before[k]).powi(2)).sum::<f64>().sqrt();
    assert!((moved - 40.0).abs() < 1.0 && after[2] > before[2], "{before:?} {after:?}");

    // A wall in the way: refused by its name, and nothing moved.
    let wall = "\n[[obstacle]]\nshape = \"floor\"\nname = \"dish\"\nz_um = -5.0\n";
    std::fs::write(here.rig(), here.text() + wall).unwrap();
    let dish = here.refusal(&["goto", "--manipulator", "1", "--pixel", "250,180", "--above-um", "-30"]);
    assert!(dish.contains("'dish'") && dish.contains("m1"), "{dish}");
    // As when axes are moved by name, unless a person says that nobody shall look.
    let z = |um: f64| format!("m1.z-={um}");
    let down = here.refusal(&["move", &z(40.0)]);
    assert!(down.contains("'dish'") && down.contains("--unguarded"), "{down}");
    assert_eq!(here.world("40x").pipettes(0)[0].tip_um, after);
    assert_eq!(here.run(&["move", &z(5.0)]).0, 0);
    assert_eq!(here.run(&["move", "--unguarded", &z(35.0)]).0, 0);
    let deep = here.world("40x").pipettes(0)[0].tip_um;
    assert!((deep[2] - after[2] + 40.0).abs() < 1.5, "{after:?} {deep:?}");
}

#[test]
fn what_is_not_known_or_is_nonsense_is_refused_by_name_and_the_file_stays() {
    let here = Folder::new();
    let text = here.text();
    let off = here.refusal(&["goto", "--pixel", "2000,10"]);
    assert!(off.contains("640x480"), "{off}");
    assert!(here.refusal(&["goto", "--pixel", "20,10"]).contains("calibrate camera"));
    assert!(here.refusal(&["calibrate", "registration", "--manipulator", "1"]).contains("calibrate camera"));
    assert!(here.refusal(&["coaxial", "--manipulator", "1", "5"]).contains("not registered"));
    assert!(here.refusal(&["objective", "100x"]).contains("20x, 40x"));
    assert_eq!(here.text(), text);
    assert_eq!(samples_in(here.folder.path()), 0);
    // A report that cannot be written is told before anything moves.
    let file = here.rig();
    let inside = file.join("report");
    let said = here.refusal(&["calibrate", "camera", "--report", inside.to_str().unwrap()]);
    assert!(said.contains("report"), "{said}");
    assert_eq!(samples_in(here.folder.path()), 0);
    // Nobody knows which objective it is.
    assert_eq!(here.run(&["objective", "--unknown"]).0, 0);
    for arguments in
        [&["goto", "--pixel", "20,10"][..], &["calibrate", "camera"], &["goto", "--pixel", "1,1", "--manipulator", "1"]]
    {
        assert!(here.refusal(arguments).contains("parfocal objective NAME"), "{arguments:?}");
    }
    assert_eq!(here.run(&["objective", "20x"]).0, 0);
    // Edited into nonsense: the key is named.
    for (from, to, key) in [
        ("width_px = 640", "width_px = 0", "camera.width_px"),
        ("index = 2", "index = 1", "axes.m1.z.index"),
        ("height_px = 480", "hight_px = 480", "camera"),
    ] {
        assert!(text.contains(from));
        std::fs::write(here.rig(), text.replacen(from, to, 1)).unwrap();
        let said = here.refusal(&["where"]);
        assert!(said.contains(key) || said.contains("index"), "{said}");
    }
}

#[test]
fn a_dry_run_draws_the_moves_and_moves_nothing() {
    let here = Folder::new();
    let report = here.folder.path().join("report");
    let report = report.to_str().unwrap();
    let (code, said) =
        here.run(&["calibrate", "camera", "--dry-run", "--report", report, "--places", "9", "--seed", "4"]);
    assert_eq!((code, said["places"].as_array().map(Vec::len)), (0, Some(9)), "{said}");
    assert!(std::fs::read_to_string(Path::new(report).join("moves.svg")).unwrap().contains("<svg"));
    assert_eq!(
        here.run(&["calibrate", "camera", "--dry-run", "--places", "9", "--seed", "4"]).1["places"],
        said["places"]
    );
    assert_eq!(samples_in(here.folder.path()), 0);
}
