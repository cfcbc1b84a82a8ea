//! The file survives people: comments stay, nonsense is refused by key, nothing is half written.

use super::*;

const EDITED: &str = r#"# Rig by the window
schema = 1
objective_in_use = "40x"   # dry

[boards]
main = { unique_id = "00ffab" }  # under the table

[axes]
scope.x = { board = "main", index = 0, moves = "stage" }
scope.z = { board = "main", index = 2, moves = "objective" }

[camera]
width_px = 1920
height_px = 1200

[objectives."4x"]
default = true

[objectives."40x"]
depth_of_field_um = 1   # 0.8 W
[[objectives."40x".zoom]]
zoom = 1
alpha = 0.1003
kappa_um = [12.0, -3, 40.0]  # after the clean-up

[manipulators.m1.registration]
model = "affine"
matrix = [[1, 0, 0, 5], [0, 1, 0, 6], [0.5, 0, 1, 7], [0, 0, 0, 1]]
[manipulators.m1.registration.record]
date = "2025-01-01T00:00:00Z"
seed = 7
samples = "m1.csv"
tolerance_um = 4
rms_um = 1.5
residuals_um = [1.5, 1.5]

[[obstacle]]
shape = "floor"
name = "dish"
z_um = -20
"#;

fn record() -> Record {
    Record {
        date: "2025-02-02T10:00:00Z".into(),
        seed: 1,
        samples: "camera.csv".into(),
        tolerance_um: 2.0,
        rms_um: 0.4,
        residuals_um: vec![0.4, 0.4],
        rejected: vec![3],
        certainty: None,
    }
}

fn lines_changed(before: &str, after: &str) -> Vec<String> {
    after.lines().filter(|line| !before.lines().any(|old| old == *line)).map(Into::into).collect()
}

#[test]
fn unchanged_contents_are_written_back_to_the_letter() {
    assert_eq!(Rig::parse(EDITED).unwrap().to_text().unwrap(), EDITED);
}

#[test]
fn one_kappa_changes_one_line_and_keeps_its_comment() {
    let mut rig = Rig::parse(EDITED).unwrap();
    rig.set_kappa("40x", 1.0, [12.0, -3.0, 41.5]).unwrap();
    let text = rig.to_text().unwrap();
    assert_eq!(lines_changed(EDITED, &text), ["kappa_um = [12.0, -3.0, 41.5]  # after the clean-up"]);
}

#[test]
fn a_tip_offset_is_added_and_the_rest_stands() {
    let mut rig = Rig::parse(EDITED).unwrap();
    let m1 = "m1".parse().unwrap();
    let tip = |x| TipOffset { date: "2025-02-02T10:00:00Z".into(), offset_um: [x, 0.0, 0.0] };
    for x in [10.0, -15.0, 5.0, 30.0] {
        assert_eq!(rig.add_tip_offset(m1, tip(x)).unwrap(), None);
    }
    let warning = rig.add_tip_offset(m1, tip(400.0)).unwrap().unwrap();
    assert!(warning.to_string().contains("m1") && warning.distance_um > 380.0 && warning.usual_um >= 50.0, "{warning}");
    let text = rig.to_text().unwrap();
    assert!(EDITED.lines().all(|line| text.contains(line)), "{text}");
    assert_eq!(Rig::parse(&text).unwrap().contents(), rig.contents());
}

#[test]
fn a_camera_calibration_and_a_new_objective_are_read_back() {
    let mut rig = Rig::parse(EDITED).unwrap();
    let calibration = CameraCalibration {
        matrix_um_per_px: [[0.32, 0.01], [0.01, -0.32]],
        objective: Some("4x".into()),
        record: record(),
    };
    rig.set_camera_calibration(calibration.clone()).unwrap();
    rig.set_zoom("10x", Zoom { zoom: 1.0, alpha: 0.4, kappa_um: [0.0, 1.0, 2.0], record: Some(record()) });
    let again = Rig::parse(&rig.to_text().unwrap()).unwrap();
    assert_eq!(again.contents().camera.as_ref().unwrap().calibration, Some(calibration));
    assert_eq!(again.contents(), rig.contents());
}

#[test]
fn a_cameras_latency_is_read_back_and_nonsense_in_it_refused() {
    let mut rig = Rig::parse(EDITED).unwrap();
    assert_eq!(rig.contents().camera.as_ref().unwrap().latency, None, "files from before have none");
    let latency = CameraLatency {
        latency_ms: 152.3,
        error_ms: 0.2,
        period_ms: 33.333,
        edge: crate::frames::pacing::Edge::Latest,
        date: "2025-02-02T10:00:00Z".into(),
    };
    rig.contents_mut().camera.as_mut().unwrap().latency = Some(latency.clone());
    let text = rig.to_text().unwrap();
    assert!(EDITED.lines().all(|line| text.contains(line)) && text.contains("edge = \"latest\""), "{text}");
    assert_eq!(Rig::parse(&text).unwrap().contents().camera.as_ref().unwrap().latency, Some(latency));
    for (good, bad) in [("152.3", "nan"), ("152.3", "1e9"), ("33.333", "0"), ("33.333", "-1"), ("latest", "last")] {
        let error = Rig::parse(&text.replacen(good, bad, 1)).unwrap_err().to_string();
        assert!(error.contains("camera.latency"), "{bad}: {error}");
    }
}

#[test]
fn nonsense_is_refused_and_the_key_is_named() {
    let cases = [
        ("schema = 1", "schema = 2", "schema 2"),
        ("schema = 1", "schema = \"one\"", "schema"),
        ("index = 0, moves = \"stage\"", "index = 2, moves = \"stage\"", "axes.scope.z.index"),
        ("board = \"main\", index = 0", "board = \"mian\", index = 0", "axes.scope.x.board"),
        (", moves = \"stage\"", "", "axes.scope.x.moves"),
        ("scope.x", "scop.x", "scop"),
        ("width_px = 1920", "width_px = -1", "camera.width_px"),
        ("width_px = 1920", "widht_px = 1920", "widht_px"),
        ("alpha = 0.1003", "alpha = 0", "objectives.40x.zoom[0].alpha"),
        ("alpha = 0.1003", "alpha = nan", "objectives.40x.zoom[0].alpha"),
        ("[0, 1, 0, 6]", "[0, 0, 0, 6]", "manipulators.m1.registration.matrix"),
        ("[0, 1, 0, 6]", "[0, 1, 6]", "manipulators.m1.registration.matrix"),
        ("[0, 0, 0, 1]", "[0, 0, 0, 2]", "manipulators.m1.registration.matrix"),
        ("objective_in_use = \"40x\"", "objective_in_use = \"60x\"", "objective_in_use"),
        ("unique_id = \"00ffab\"", "unique_id = \"port 3\"", "boards.main.unique_id"),
        ("z_um = -20", "z_um = inf", "obstacle[0].z_um"),
        ("shape = \"floor\"", "shape = \"sphere\"", "obstacle[0]"),
        ("[manipulators.m1.registration]", "[manipulators.m0.registration]", "m0"),
        ("[camera]", "[camera", "not TOML"),
    ];
    for (good, bad, named) in cases {
        assert!(EDITED.contains(good), "{good}");
        let error = Rig::parse(&EDITED.replacen(good, bad, 1)).unwrap_err().to_string();
        assert!(error.contains(named), "{bad}: {error}");
    }
}

#[test]
fn a_save_that_fails_leaves_the_old_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    std::fs::write(&path, EDITED).unwrap();
    let mut rig = Rig::load(&path).unwrap();
    rig.contents_mut().objectives.get_mut("40x").unwrap().zooms[0].alpha = -1.0;
    assert!(matches!(rig.save(&path), Err(RigError::Value { .. })));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), EDITED);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
    assert!(matches!(rig.clone().save(&folder.path().join("none/rig.toml")), Err(RigError::Value { .. })));
    assert!(matches!(Rig::new().save(&folder.path().join("none/rig.toml")), Err(RigError::Write { .. })));
}

#[test]
fn a_file_edited_meanwhile_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    std::fs::write(&path, EDITED).unwrap();
    let mut rig = Rig::load(&path).unwrap();
    rig.save(&path).unwrap();
    std::fs::write(&path, EDITED.replace("window", "door")).unwrap();
    assert!(matches!(rig.save(&path), Err(RigError::Changed { .. })));
    assert!(std::fs::read_to_string(&path).unwrap().contains("door"));
}

#[test]
fn the_focus_knob_changes_one_number_and_counts_in_every_objective() {
    use crate::calibration::chain::{Chain, Pixel};
    let mut rig = Rig::parse(EDITED).unwrap();
    rig.contents_mut().camera.as_mut().unwrap().calibration =
        Some(CameraCalibration { matrix_um_per_px: [[1.0, 0.0], [0.0, 1.0]], objective: None, record: record() });
    let before = rig.to_text().unwrap();
    let focus = |rig: &Rig| {
        let middle = Pixel { x_px: 959.5, y_px: 599.5 };
        Chain::of(rig).unwrap().pixel_to_ref(nalgebra::Vector3::zeros(), middle).coordinates.z
    };
    let z = focus(&rig);
    rig.shift_focus(3.0);
    assert_eq!(lines_changed(&before, &rig.to_text().unwrap()), ["objective_height_um = 3.0"]);
    assert_eq!(focus(&rig), z + 3.0);
    rig.shift_focus(-3.0);
    assert_eq!(rig.to_text().unwrap(), before);
}
