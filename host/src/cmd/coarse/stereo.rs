//! The stereo camera: from a file, or calibrated from pairs of the printed board.

use super::super::Output;
use super::{Arguments, pairs};
use anyhow::Context;
use parfocal::calibration::coarse::board::{Board, calibrate as solve};
use parfocal::calibration::coarse::{MarkerId, StereoCamera};
use parfocal::rig::Rig;
use serde_json::json;
use std::path::Path;

/// Reads `stereo.json`, or the table `[stereo]` of a rig file.
pub(super) fn read(file: &Path) -> anyhow::Result<StereoCamera> {
    if file.extension().is_some_and(|e| e == "toml") {
        let rig = Rig::load(file).with_context(|| format!("{}", file.display()))?;
        return rig.contents().stereo.clone().with_context(|| {
            format!("{}: has no table [stereo]: calibrate the camera with --calibrate-stereo first", file.display())
        });
    }
    let json = std::fs::read_to_string(file).with_context(|| format!("{}: cannot be read", file.display()))?;
    StereoCamera::from_json(&json).with_context(|| format!("{}", file.display()))
}

/// The board described by the arguments.
pub(super) fn board(a: &Arguments) -> Board {
    let first = MarkerId(a.board_first);
    Board { columns: a.board.0, rows: a.board.1, first, tag_mm: a.board_tag_mm, gap_mm: a.board_gap_mm }
}

pub(super) fn calibrate(arguments: &Arguments, folder: &Path, out: Output) -> anyhow::Result<()> {
    let found = solve(&pairs::read(folder)?, &board(arguments))?;
    for file in arguments.out.iter().chain(arguments.rig.iter().filter(|_| !arguments.dry_run)) {
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

/// Writes `stereo.json`, or the table `[stereo]` of a rig's file, the rest of which stays as it is.
fn write(file: &Path, camera: &StereoCamera) -> anyhow::Result<()> {
    if file.extension().is_some_and(|e| e == "toml") {
        let mut rig = if file.exists() { Rig::load(file)? } else { Rig::new() };
        rig.contents_mut().stereo = Some(camera.clone());
        return Ok(rig.save(file)?);
    }
    let text = serde_json::to_string_pretty(camera)? + "\n";
    std::fs::write(file, text).with_context(|| format!("{}: cannot be written", file.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_written_into_a_rig_file_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rig.toml");
        std::fs::write(&file, "# rig\nschema = 1\nname = \"by the window\" # mine\n").unwrap();
        let lens = json!({ "fx": 1100.0, "fy": 1101.0, "cx": 640.0, "cy": 480.0, "k1": -0.1 });
        let camera = json!({ "image_size": [1280, 960], "left": lens, "right": lens,
            "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t_m": [-0.06, 0.0, 0.0] });
        let camera = StereoCamera::from_json(&camera.to_string()).unwrap();
        for _ in 0..2 {
            write(&file, &camera).unwrap();
            assert_eq!(read(&file).unwrap(), camera);
        }
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(
            text.starts_with("# rig\nschema = 1\nname = \"by the window\" # mine\n")
                && text.matches("[stereo]").count() == 1,
            "{text}"
        );
    }
}
