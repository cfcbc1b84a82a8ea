//! The command on real stacks and on stacks that cannot be focused.

use parfocal_tests::{parfocal_json, shared_data};
use serde_json::Value;

fn autofocus(camera: &str, more: &[&str]) -> (i32, Value) {
    parfocal_json(&[&["autofocus", "--camera", camera], more].concat())
}

fn stack(name: &str) -> String {
    format!("stack:{}", shared_data(name).display())
}

/// Plane step of the tip stack, µm; planes 24 and 25 are in focus by the operator and by Tenengrad.
const TIP_STEP: f64 = 1.57;

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn the_real_tip_is_found_from_every_plane() {
    let camera = stack("acq4_pipette_tip");
    for plane in 0..52 {
        let start = format!("--start={}", f64::from(plane) * TIP_STEP);
        let (code, said) = autofocus(&camera, &[&start]);
        assert_eq!((code, said["outcome"].as_str()), (0, Some("focused")), "from plane {plane}: {said}");
        let z = said["z_um"].as_f64().unwrap();
        let off = (24.0 * TIP_STEP - z).max(z - 25.0 * TIP_STEP).max(0.0);
        assert!(off <= 1.6, "from plane {plane} to {z} µm, {off} µm off");
    }
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn a_range_smaller_than_the_trap_is_simply_scanned() {
    let (code, said) = autofocus(&stack("dfnn_mitochondria"), &[]);
    let z = said["z_um"].as_f64().unwrap();
    // Truth: plane 19 at 0 µm, planes 0.05 µm apart.
    assert!(code == 0 && z.abs() <= 0.1, "{said}");
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn a_peak_at_the_edge_is_refused_and_the_axis_goes_back() {
    let (code, said) = autofocus(&stack("bfdc_edge_peak"), &[]);
    assert_eq!((code, said["reason"].as_str()), (1, Some("peak at the edge of the range")));
    assert_eq!(said["z_um"], said["start_um"]);
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn an_unstained_cell_is_a_phase_object_and_has_its_own_mode() {
    let camera = stack("bfautofocus_yeast");
    let (code, said) = autofocus(&camera, &[]);
    assert_eq!((code, said["reason"].as_str()), (1, Some("phase object")), "{said}");
    let (code, said) = autofocus(&camera, &["--phase-object"]);
    let z = said["z_um"].as_f64().unwrap();
    assert!(code == 0 && (z - 15.0 * 0.3).abs() <= 0.6, "{said}");
}

#[test]
fn a_black_stack_is_refused_for_no_contrast_and_a_white_one_as_saturated() {
    for (grey, reason) in [(0u8, "no contrast"), (255, "saturated"), (90, "no contrast")] {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("stack.toml"), "z_step_um = 1.0\n").unwrap();
        for plane in 0..12 {
            image::GrayImage::from_pixel(32, 32, image::Luma([grey]))
                .save(folder.path().join(format!("z{plane:02}.png")))
                .unwrap();
        }
        let (code, said) = autofocus(&format!("stack:{}", folder.path().display()), &[]);
        assert_eq!((code, said["outcome"].as_str(), said["reason"].as_str()), (1, Some("refused"), Some(reason)));
        assert_eq!(said["z_um"], said["start_um"]);
    }
}

#[test]
fn the_simulated_rig_focuses_its_own_tip_and_repeats_to_the_bit() {
    let (code, first) = parfocal_json(&["autofocus", "--seed", "3"]);
    let z = first["z_um"].as_f64().unwrap();
    // The first pipette's tip lies at 0; the sharpest plane of the tip's first lobe just below it.
    assert!(code == 0 && z.abs() <= 1.6, "{first}");
    assert_eq!(parfocal_json(&["autofocus", "--seed", "3"]).1, first);
}

#[test]
fn a_manipulators_axis_brings_its_tip_into_focus_under_a_fixed_lens() {
    // The lens looks at 40 µm, the tip lies at 0: the pipette has to rise.
    let (code, said) = parfocal_json(&["autofocus", "--axis", "m1.z", "--mode", "sweep", "--range=-60..100"]);
    let z = said["z_um"].as_f64().unwrap();
    assert!(code == 0 && (z - 40.0).abs() <= 1.6, "{z}: {said}");
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn without_a_region_the_sharpest_texture_is_taken_and_said() {
    let camera = stack("acq4_pipette_tip");
    let output = parfocal_tests::parfocal().args(["autofocus", "--camera", &camera, "--roi", "auto"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{output:?}");
    let line = said.lines().find(|line| line.starts_with("region ")).unwrap_or_else(|| panic!("{said}"));
    assert!(line.contains("the sharpest texture where the scan begins"), "{line}");
    println!("{line}: {}", String::from_utf8_lossy(&output.stdout));
}
