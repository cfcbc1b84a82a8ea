//! `parfocal calibrate latency` to its end, on the simulated rig's own picture, and what it is good for.

use parfocal_tests::parfocal_json;

/// A camera that says only when its frames arrive: 20 to 40 ms late, 5 ms of exposure.
const CAMERA: &str = "sim?fps=30&exposure_ms=5&delay_ms=20..40&stamps=arrival";

/// From the middle of an exposure to the latest arrival, ms.
const LATEST: f64 = 40.0 + 5.0 / 2.0;

#[test]
fn a_camera_without_exposure_times_sweeps_once_it_is_calibrated() {
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    let rig = rig.to_str().unwrap();
    let run = |arguments: &[&str]| parfocal_json(&[arguments, &["--rig", rig, "--camera", CAMERA]].concat());
    let (code, said) = parfocal_json(&["setup", "--simulated", "--out", rig]);
    assert_eq!(code, 0, "{said}");

    let sweep = ["autofocus", "--mode", "sweep", "--range=-40..40"];
    let (code, said) = run(&sweep);
    assert!(code == 1 && said["error"].as_str().unwrap().contains("calibrate latency"), "{said}");

    // Nothing is kept before it is asked for.
    let before = std::fs::read_to_string(rig).unwrap();
    assert!(!before.contains("latency"), "{before}");
    let (code, said) = run(&["calibrate", "latency", "--reach-um", "30", "--repeats", "2"]);
    assert_eq!(code, 0, "{said}");
    let number = |name: &str| said[name].as_f64().unwrap_or_else(|| panic!("no {name}: {said}"));
    let (late, error) = (number("latency_ms"), number("error_ms"));
    assert!(said["exposure_told"] == false && said["edge"] == "latest" && error < 12.0, "{said}");
    assert!((late - LATEST).abs() < 3.0 * error.max(1.5), "{late} ± {error} ms instead of {LATEST}");
    assert!((number("period_ms") - 1000.0 / 30.0).abs() < 0.01, "{said}");
    let kept = std::fs::read_to_string(rig).unwrap();
    assert!(kept.contains("[camera.latency]"), "{kept}");

    let (code, said) = run(&sweep);
    let z = said["z_um"].as_f64().unwrap_or_else(|| panic!("{said}"));
    // The tip lies at 0, and has two tops some µm apart.
    assert!(code == 0 && z.abs() < 8.0, "{said}");
}
