//! What people get wrong: one sentence that says what and where, and exit code 1; bad usage is 2.

use parfocal_tests::parfocal;
use std::path::Path;

/// Exit code and stderr of `parfocal ARGUMENTS`.
fn fails(arguments: &[&str]) -> (i32, String) {
    let output = parfocal().args(arguments).output().unwrap();
    (output.status.code().unwrap_or(-1), String::from_utf8_lossy(&output.stderr).into_owned())
}

fn stack(about: &str, sizes: &[u32]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("stack.toml"), about).unwrap();
    for (i, size) in sizes.iter().enumerate() {
        let picture = image::GrayImage::from_fn(*size, 16, |x, y| image::Luma([((x * 7 + y * 3) % 200) as u8]));
        picture.save(folder.path().join(format!("z{i:02}.png"))).unwrap();
    }
    folder
}

fn autofocus(folder: &Path) -> (i32, String) {
    fails(&["autofocus", "--camera", &format!("stack:{}", folder.display())])
}

#[test]
fn a_stack_that_is_no_stack() {
    for (about, sizes, says) in [
        ("z_step_um = 1.0", &[16u32, 16, 17][..], "z02.png: is 17x16"),
        ("first_z_um = 1.0", &[16, 16], "missing field `z_step_um`"),
        ("z_step_um = -1.0", &[16, 16], "z_step_um = -1: must lie between"),
        ("z_step_um = 1.0\nroi_px = [0, 0, 0, 5]", &[16, 16], "roi_px: the region 0,0,0,5 is empty"),
        ("z_step_um = 1.0", &[], "holds no PNG, TIFF or JPEG"),
    ] {
        let folder = stack(about, sizes);
        let (code, said) = autofocus(folder.path());
        assert!(code == 1 && said.contains(says), "{about}: {code} {said}");
    }
    assert!(autofocus(Path::new("nowhere")).1.contains("nowhere"));
}

#[test]
fn a_picture_that_cannot_be_read() {
    let folder = stack("z_step_um = 1.0", &[16, 16]);
    std::fs::write(folder.path().join("z01.png"), b"\x89PNG\r\n\x1a\nrubbish").unwrap();
    let (code, said) = autofocus(folder.path());
    assert!(code == 1 && said.contains("z01.png"), "{said}");
}

#[test]
fn a_region_outside_the_picture() {
    let folder = stack("z_step_um = 1.0", &[16, 16]);
    let camera = format!("stack:{}", folder.path().display());
    let (code, said) = fails(&["autofocus", "--camera", &camera, "--roi", "10,10,10,10"]);
    assert!(code == 1 && said.contains("leaves the picture of 16x16"), "{said}");
}

#[test]
fn a_port_that_is_not_there() {
    let (code, said) = fails(&["--port", "/dev/no-such-port", "status"]);
    assert!(code == 1 && said.contains("/dev/no-such-port"), "{said}");
}

#[test]
fn moves_that_are_refused_name_the_axis_and_its_range() {
    let (code, said) = fails(&["move", "scope.z=5000"]);
    assert!(code == 1 && said.contains("scope.z may only go from -200 to 200"), "{said}");
    let (code, said) = fails(&["move", "m9.x=1"]);
    assert!(code == 1 && said.contains("this rig has no axis m9.x; it has"), "{said}");
}

#[test]
fn settings_that_are_refused_name_the_field_and_its_range() {
    for (change, says) in [
        ("steps_per_um=-3", "steps_per_um must lie between"),
        ("speed_um_s=0", "speed_um_s must lie between"),
        ("low_um=500", "high_um must lie between 500"),
        ("sped=1", "there is no setting 'sped'"),
    ] {
        let (code, said) = fails(&["settings", "set", "scope.z", change]);
        assert!(code == 1 && said.contains(says), "{change}: {said}");
    }
}

#[test]
fn bad_usage_is_told_apart() {
    for arguments in [
        &["autofocus", "--range", "5..-5"][..],
        &["autofocus", "--measure", "sharpness"],
        &["move", "scope.z"],
        &["nonsense"],
        &["autofocus", "--camera", "film:x"],
    ] {
        assert_eq!(fails(arguments).0, 2, "{arguments:?}");
    }
}

#[test]
fn with_json_a_failure_is_one_object_too() {
    let (code, said) = parfocal_tests::parfocal_json(&["move", "scope.z=5000"]);
    assert!(code == 1 && said["error"].as_str().unwrap().contains("scope.z"), "{said}");
}
