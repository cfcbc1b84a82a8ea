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
fn regions_and_pictures_too_small_to_measure() {
    let folder = stack("z_step_um = 1.0", &[16, 16]);
    let camera = format!("stack:{}", folder.path().display());
    for (roi, says) in [
        ("3,3,0,5", "is empty"),
        ("3,3,5,0", "is empty"),
        ("3,3,1,1", "at least 3x3 pixels, this one is 1x1"),
        ("16,0,1,1", "leaves the picture"),
        ("18446744073709551615,0,2,2", "leaves the picture"),
    ] {
        let (code, said) = fails(&["autofocus", "--camera", &camera, "--roi", roi]);
        assert!(code == 1 && said.contains(says), "{roi}: {code} {said}");
    }
    let tiny = tempfile::tempdir().unwrap();
    std::fs::write(tiny.path().join("stack.toml"), "z_step_um = 1.0").unwrap();
    for plane in 0..3 {
        image::GrayImage::from_pixel(1, 1, image::Luma([plane * 50]))
            .save(tiny.path().join(format!("{plane}.png")))
            .unwrap();
    }
    let (code, said) = autofocus(tiny.path());
    assert!(code == 1 && said.contains("at least 3x3 pixels, this one is 1x1"), "{said}");
}

#[test]
fn colour_is_converted_and_said() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("stack.toml"), "z_step_um = 1.0").unwrap();
    for plane in 0..40i32 {
        let contrast = 100.0 * (-f64::from((plane - 17) * (plane - 17)) / 80.0).exp();
        let picture = image::RgbImage::from_fn(32, 32, |x, _| {
            let grey = (120.0 + if x / 2 % 2 == 0 { contrast } else { -contrast }) as u8;
            image::Rgb([grey, grey, grey])
        });
        picture.save(folder.path().join(format!("{plane:02}.png"))).unwrap();
    }
    let camera = format!("stack:{}", folder.path().display());
    let output = parfocal().args(["autofocus", "--camera", &camera]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && said.contains("colour, converted to grey"), "{output:?}");
}

#[test]
fn sweeps_that_make_no_sense() {
    let camera = concat!("curve:", env!("CARGO_MANIFEST_DIR"), "/golden/curve.csv");
    let sweep = |speed: &str| fails(&["autofocus", "--mode", "sweep", "--camera", camera, "--speed-um-s", speed]);
    for (speed, says) in [
        ("0", "a speed of 0 µm/s is none"),
        ("-20", "a speed of -20 µm/s is none"),
        ("nan", "is none"),
        ("inf", "is none"),
        ("900", "Sweep at 500 µm/s or slower"),
    ] {
        let (code, said) = sweep(speed);
        assert!(code == 1 && said.contains(says), "{speed}: {code} {said}");
    }
    for option in ["fps=0", "fps=x", "exposure_ms=50&fps=30", "delay_ms=150..20", "stamps=maybe", "colour=1", "fps"] {
        let (code, said) = fails(&["autofocus", "--camera", &format!("sim?{option}")]);
        assert!(code == 2 && said.contains("sim?"), "{option}: {code} {said}");
    }
    // Nothing is drawn before the refusal: the camera tells no exposure times and was never calibrated.
    let (code, said) = fails(&["autofocus", "--mode", "sweep", "--camera", "sim?stamps=arrival"]);
    assert!(code == 1 && said.contains("its latency is not calibrated"), "{said}");
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
