//! The stereo camera: from a file, or calibrated from pairs of the printed board.

use super::super::Output;
use super::{Arguments, pairs};
use anyhow::{Context, bail};
use parfocal::calibration::coarse::board::{Board, calibrate as solve};
use parfocal::calibration::coarse::{MarkerId, StereoCamera};
use serde_json::json;
use std::path::Path;

/// Reads `stereo.json`, or the table `[stereo]` of a rig file.
pub(super) fn read(file: &Path) -> anyhow::Result<StereoCamera> {
    let text = std::fs::read_to_string(file).with_context(|| format!("{}: cannot be read", file.display()))?;
    let rig = file.extension().is_some_and(|e| e == "toml");
    let json = if rig {
        let table: toml::Table = toml::from_str(&text).with_context(|| format!("{}: is no TOML", file.display()))?;
        let Some(stereo) = table.get("stereo") else {
            bail!("{}: has no table [stereo]: calibrate the camera with --calibrate-stereo first", file.display());
        };
        serde_json::to_string(stereo)?
    } else {
        text
    };
    StereoCamera::from_json(&json).with_context(|| format!("{}", file.display()))
}

/// The board described by the arguments.
pub(super) fn board(a: &Arguments) -> Board {
    let first = MarkerId(a.board_first);
    Board { columns: a.board.0, rows: a.board.1, first, tag_mm: a.board_tag_mm, gap_mm: a.board_gap_mm }
}

pub(super) fn calibrate(arguments: &Arguments, folder: &Path, out: Output) -> anyhow::Result<()> {
    let found = solve(&pairs::read(folder)?, &board(arguments))?;
    if let Some(file) = &arguments.out {
        write(file, &found.camera)?;
    }
    let (left, right) = (&found.camera.left, &found.camera.right);
    let text = format!(
        "{} pairs, {:.3} px RMS\nfocal lengths {:.2} ± {:.2} px and {:.2} ± {:.2} px, baseline {}",
        found.used.len(),
        found.rms_px,
        left.fx,
        found.standard_errors[0][0],
        right.fx,
        found.standard_errors[1][0],
        found.camera.baseline(),
    );
    let value = json!({
        "stereo": found.camera,
        "rms_px": found.rms_px,
        "standard_errors": found.standard_errors,
        "used": found.used,
        "left_out": found.left_out,
    });
    out.result(&text, &value)
}

/// Writes `stereo.json`, or adds the table `[stereo]` at the end of a rig file, replacing one that is there.
fn write(file: &Path, camera: &StereoCamera) -> anyhow::Result<()> {
    let text = if file.extension().is_some_and(|e| e == "toml") {
        let before = if file.exists() { std::fs::read_to_string(file)? } else { String::new() };
        let kept = without_stereo(&before);
        let mut table = toml::Table::new();
        table.insert("stereo".into(), toml::Value::try_from(camera)?);
        let gap = if kept.is_empty() || kept.ends_with("\n\n") { "" } else { "\n" };
        format!("{kept}{gap}{}", toml::to_string(&table)?)
    } else {
        serde_json::to_string_pretty(camera)? + "\n"
    };
    std::fs::write(file, text).with_context(|| format!("{}: cannot be written", file.display()))
}

/// The lines of a rig file but for the tables `[stereo]` and `[stereo.…]`; comments and order stay.
fn without_stereo(text: &str) -> String {
    let mut inside = false;
    let mut kept = String::new();
    for line in text.lines() {
        if line.trim_start().starts_with('[') {
            let name = line.trim().trim_start_matches('[');
            inside = name.starts_with("stereo]") || name.starts_with("stereo.");
        }
        if !inside {
            kept += line;
            kept.push('\n');
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rig_file_keeps_all_but_the_old_stereo_camera() {
        let before = "# my rig\n[axis]\na = 1\n\n[stereo]\nold = 1\n[stereo.left]\nfx = 2\n[other]\nb = 2 # kept\n";
        assert_eq!(without_stereo(before), "# my rig\n[axis]\na = 1\n\n[other]\nb = 2 # kept\n");
    }

    #[test]
    fn a_camera_written_into_a_rig_file_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rig.toml");
        std::fs::write(&file, "# rig\n[axis]\na = 1\n").unwrap();
        let lens = json!({ "fx": 1100.0, "fy": 1101.0, "cx": 640.0, "cy": 480.0, "k1": -0.1 });
        let camera = json!({ "image_size": [1280, 960], "left": lens, "right": lens,
            "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t_m": [-0.06, 0.0, 0.0] });
        let camera = StereoCamera::from_json(&camera.to_string()).unwrap();
        for _ in 0..2 {
            write(&file, &camera).unwrap();
            assert_eq!(read(&file).unwrap(), camera);
        }
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(text.starts_with("# rig\n[axis]") && text.matches("[stereo]").count() == 1, "{text}");
    }
}
