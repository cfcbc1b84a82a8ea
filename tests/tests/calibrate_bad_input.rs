//! Samples that give no calibration, through the command: a sentence naming the row or key, and the old calibration stays in force.

use parfocal_tests::{parfocal, parfocal_json};
use std::fmt::Write;
use std::path::Path;

const RIG: &str = r#"schema = 1
objective_in_use = "4x"
[camera]
width_px = 640
height_px = 480
[camera.calibration]
matrix_um_per_px = [[1.0, 0.0], [0.0, 1.0]]
objective = "4x"
[camera.calibration.record]
date = "2025-01-01T00:00:00Z"
seed = 7
samples = "old.csv"
tolerance_um = 4.0
rms_um = 1.5
residuals_um = [1.5, 1.5, 1.5]
[objectives.4x]
default = true
"#;

/// A folder with a rig's file; runs commands on it and looks whether the file stayed.
struct Bench(tempfile::TempDir);

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("rig.toml"), RIG).unwrap();
        Self(folder)
    }

    fn file(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }

    /// `parfocal calibrate ARGUMENTS --samples … --rig …` must fail and say this, the rig's file untouched.
    fn refuses(&self, csv: &str, arguments: &[&str], says: &[&str]) {
        std::fs::write(self.file("samples.csv"), csv).unwrap();
        let output = parfocal()
            .arg("calibrate")
            .args(arguments)
            .args(["--samples", &self.file("samples.csv"), "--rig", &self.file("rig.toml")])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
        for part in says {
            assert!(said.contains(part), "'{part}' is not in: {said}");
        }
        assert_eq!(std::fs::read_to_string(self.file("rig.toml")).unwrap(), RIG);
    }
}

const CAMERA: &str = "mic_x_um,mic_y_um,image_x_px,image_y_px\n";
const MAN: &str = "man_x_um,man_y_um,man_z_um,ref_x_um,ref_y_um,ref_z_um\n";

fn rows<const N: usize>(header: &str, points: &[[f64; N]]) -> String {
    points.iter().fold(header.to_owned(), |mut text, p| {
        let row: Vec<String> = p.iter().map(f64::to_string).collect();
        let _ = writeln!(text, "{}", row.join(","));
        text
    })
}

/// A point seen by a camera of 0.5 µm a px at microscope positions.
fn seen(positions: &[[f64; 2]]) -> String {
    let row = |[x, y]: &[f64; 2]| [*x, *y, 320.0 - 2.0 * x, 240.0 - 2.0 * y];
    rows(CAMERA, &positions.iter().map(row).collect::<Vec<_>>())
}

/// Tips in ref of a manipulator whose x axis leans, at joint positions.
fn tips(joints: &[[f64; 3]]) -> String {
    let row = |[x, y, z]: &[f64; 3]| [*x, *y, *z, 0.866 * x + 100.0, *y, z - 0.5 * x];
    rows(MAN, &joints.iter().map(row).collect::<Vec<_>>())
}

#[test]
fn too_few_samples() {
    let bench = Bench::new();
    bench.refuses(&seen(&[[0., 0.], [50., 0.]]), &["camera"], &["2 samples", "at least 3"]);
    bench.refuses(CAMERA, &["camera"], &["0 samples", "at least 3"]);
    let three = tips(&[[0., 0., 0.], [100., 0., 0.], [0., 100., 0.]]);
    bench.refuses(&three, &["registration", "--manipulator", "1"], &["3 samples", "at least 4"]);
}

#[test]
fn flat_and_repeated_ones() {
    let bench = Bench::new();
    let line: Vec<[f64; 2]> = (0..8).map(|i| [10.0 * f64::from(i), 5.0 * f64::from(i)]).collect();
    bench.refuses(&seen(&line), &["camera"], &["on a line", "move along"]);
    let plane: Vec<[f64; 3]> = (0..9).map(|i| [60.0 * f64::from(i % 3), 60.0 * f64::from(i / 3), 0.0]).collect();
    bench.refuses(&tips(&plane), &["registration", "--manipulator", "1"], &["in a plane", "move along z"]);
    let twice = [[0., 0.], [50., 0.], [0., 50.], [50., 0.]];
    bench.refuses(&seen(&twice), &["camera"], &["rows 2 and 4", "same microscope position"]);
    let tiny: Vec<[f64; 3]> = [[0., 0., 0.], [0.5, 0., 0.], [0., 0.5, 0.], [0., 0., 0.5], [0.3, 0.3, 0.3]].into();
    bench.refuses(&tips(&tiny), &["registration", "--manipulator", "1"], &["span only 0.5"]);
}

#[test]
fn what_is_no_number_or_no_column() {
    let bench = Bench::new();
    let good = seen(&[[0., 0.], [50., 0.], [0., 50.], [50., 50.]]);
    bench.refuses(&good.replace("50,0,", "50,NaN,"), &["camera"], &["row 2, mic_y_um", "NaN"]);
    bench.refuses(&good.replace("mic_y_um", "mic_y"), &["camera"], &["no column mic_y_um"]);
    bench.refuses("", &["camera"], &["no column"]);
}

#[test]
fn wrong_units() {
    let bench = Bench::new();
    // Pixels in the µm columns.
    let places = [[100., 90.], [400., 100.], [150., 380.], [500., 300.], [320., 200.]];
    let same: Vec<[f64; 4]> = places.iter().map(|[x, y]| [*x, *y, *x, *y]).collect();
    bench.refuses(&rows(CAMERA, &same), &["camera"], &["mic_x_um", "same numbers as image_x_px"]);
    // µm where pixels belong: off the sensor.
    let off: Vec<[f64; 4]> = places.iter().map(|[x, y]| [*x, *y, 320.0 - 9.0 * x, *y]).collect();
    bench.refuses(&rows(CAMERA, &off), &["camera"], &["row 1", "not on the sensor of 640x480"]);
    // Millimetres where µm belong.
    let mm: Vec<[f64; 4]> = places.iter().map(|[x, y]| [-x / 1e5, -y / 1e5, *x, *y]).collect();
    bench.refuses(&rows(CAMERA, &mm), &["camera"], &["µm"]);
    // Steps of 1/16 µm where the joints' µm belong.
    let joints = [[0., 0., 0.], [100., 0., 0.], [0., 100., 0.], [0., 0., 100.], [80., 90., 70.], [30., 60., 95.]];
    let steps: Vec<[f64; 6]> =
        joints.iter().map(|[x, y, z]| [16.0 * x, 16.0 * y, 16.0 * z, 0.866 * x, *y, z - 0.5 * x]).collect();
    bench.refuses(
        &rows(MAN, &steps),
        &["registration", "--manipulator", "1"],
        &["x axis", "0.062", "steps", "--axis-scale"],
    );
}

#[test]
fn mirrored_axes_and_the_rigid_model() {
    let bench = Bench::new();
    let joints = [
        [0., 0., 0.],
        [100., 0., 0.],
        [0., 100., 0.],
        [0., 0., 100.],
        [80., 90., 70.],
        [30., 60., 95.],
        [70., 5., 40.],
    ];
    let left_handed: Vec<[f64; 6]> = joints.iter().map(|[x, y, z]| [*x, *y, *z, *x, -y, *z]).collect();
    let csv = rows(MAN, &left_handed);
    bench.refuses(&csv, &["registration", "--model", "rigid"], &["rigid model does not fit", "mirrored", "affine"]);
    bench.refuses(&csv, &["registration", "--model", "similarity"], &["similarity model does not fit", "mirrored"]);
    // Affine takes and reports them.
    std::fs::write(bench.file("samples.csv"), csv).unwrap();
    let (code, said) = parfocal_json(&["calibrate", "registration", "--samples", &bench.file("samples.csv")]);
    assert!(code == 0 && said["mirrored"] == true, "{said}");
}

#[test]
fn a_report_that_cannot_be_written_changes_nothing() {
    let bench = Bench::new();
    let good = seen(&[[0., 0.], [50., 0.], [0., 50.], [50., 50.], [20., 30.]]);
    // A file stands where the folder should be.
    let taken = bench.file("taken");
    std::fs::write(&taken, "").unwrap();
    bench.refuses(&good, &["camera", "--report", &taken], &["cannot make the report's folder", "taken"]);
    let inside = format!("{taken}/report");
    bench.refuses(&good, &["camera", "--report", &inside], &["cannot make the report's folder"]);
    // The folder is there, but a folder has the name of one of the files.
    let folder = bench.file("report");
    std::fs::create_dir_all(Path::new(&folder).join("report.md")).unwrap();
    bench.refuses(&good, &["camera", "--report", &folder], &["cannot write the report's file", "report.md"]);
}

#[test]
fn a_rig_file_edited_into_nonsense_is_refused_by_its_key() {
    let bench = Bench::new();
    std::fs::write(bench.file("samples.csv"), seen(&[[0., 0.], [50., 0.], [0., 50.], [50., 50.]])).unwrap();
    for (from, to, says) in [
        ("[[1.0, 0.0], [0.0, 1.0]]", "[[1.0, 0.0], [2.0, 0.0]]", "camera.calibration.matrix_um_per_px is singular"),
        ("width_px = 640", "width_px = \"wide\"", "camera.width_px"),
        ("objective_in_use = \"4x\"", "objective_in_use = \"5x\"", "objective_in_use names '5x'"),
        ("schema = 1", "schema = 99", "schema 99"),
        ("height_px = 480", "heigth_px = 480", "heigth_px"),
        ("schema = 1", "schema = ", "not TOML"),
    ] {
        let nonsense = RIG.replace(from, to);
        std::fs::write(bench.file("rig.toml"), &nonsense).unwrap();
        let arguments =
            ["calibrate", "camera", "--samples", &bench.file("samples.csv"), "--rig", &bench.file("rig.toml")];
        let output = parfocal().args(arguments).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(1) && said.contains(says), "{to}: {said}");
        assert_eq!(std::fs::read_to_string(bench.file("rig.toml")).unwrap(), nonsense);
    }
}
