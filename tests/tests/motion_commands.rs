//! What an axis can be told on the command line besides moving: home, jog, vibrate, hold, declare, camera pulses; and what
//! people get wrong with it.

use parfocal_tests::{parfocal, parfocal_json};
use serde_json::Value;

/// Runs a command on the simulated rig; its JSON.
fn done(arguments: &[&str]) -> Value {
    let (code, said) = parfocal_json(arguments);
    assert_eq!(code, 0, "{arguments:?}: {said}");
    said
}

/// The error of a command that is refused.
fn refused(arguments: &[&str]) -> String {
    let (code, said) = parfocal_json(arguments);
    assert_eq!(code, 1, "{arguments:?}: {said}");
    said["error"].as_str().unwrap().to_string()
}

#[test]
fn homing_ends_at_the_switch() {
    // The simulated switch lies 50 µm beyond the lower limit of -200 µm; debouncing lets the slow approach go on a little.
    let at = done(&["home", "scope.z"])["homed_um"]["scope.z"].as_f64().unwrap();
    assert!((at + 250.0).abs() < 1.0, "{at}");
}

#[test]
fn a_jog_goes_on_for_its_time_and_at_most_to_the_limit() {
    let at = done(&["jog", "scope.x=-100", "--for-s", "1.5"])["positions_um"]["scope.x"].as_f64().unwrap();
    assert!((at + 150.0).abs() < 3.0, "{at}");
    let said = done(&["jog", "scope.z=1000", "scope.y=50", "--for-s", "1"]);
    assert_eq!(said["positions_um"]["scope.z"], 200.0, "{said}");
    let y = said["positions_um"]["scope.y"].as_f64().unwrap();
    assert!((y - 50.0).abs() < 3.0, "{said}");
}

#[test]
fn a_vibration_ends_where_it_began() {
    let said = done(&["vibrate", "scope.z", "--amplitude-um", "3", "--frequency-hz", "8", "--cycles", "4"]);
    assert_eq!(said["position_um"], 40.0, "{said}");
}

#[test]
fn a_declared_position_is_where_the_axis_is() {
    assert_eq!(done(&["declare", "scope.z=12.5", "m1.x=0"])["positions_um"]["scope.z"], 12.5);
}

#[test]
fn the_current_is_switched() {
    assert_eq!(done(&["disable", "m1.x", "m1.y"])["enabled"], false);
    assert_eq!(done(&["enable", "m1.x"])["enabled"], true);
}

#[test]
fn camera_pulses_are_told_with_index_and_position() {
    let said = done(&["move", "scope.z=60", "--pulse-every-um", "2.5"]);
    let pulses = said["pulses"].as_array().unwrap();
    assert_eq!(pulses.len(), 8, "{said}");
    for (i, pulse) in pulses.iter().enumerate() {
        assert_eq!(pulse["index"], i);
        assert_eq!(pulse["position_um"], 42.5 + 2.5 * i as f64);
    }
    // Downwards, from a place of one's own, and at listed places in any order.
    let said = done(&["move", "scope.z=0", "--pulse-every-um", "10", "--pulse-from-um", "25"]);
    let at = |said: &Value| -> Vec<f64> {
        said["pulses"].as_array().unwrap().iter().map(|p| p["position_um"].as_f64().unwrap()).collect()
    };
    assert_eq!(at(&said), [25.0, 15.0, 5.0]);
    let said = done(&["move", "scope.z=0", "scope.x=5", "--pulse-at-um", "10,30,20", "--pulse-axis", "scope.z"]);
    assert_eq!(at(&said), [30.0, 20.0, 10.0]);
}

#[test]
fn two_boards_move_together_for_longer_than_their_host_timeout() {
    let said = done(&["move", "scope.x=5000", "m2.y=4000"]);
    assert_eq!(said["positions_um"]["m2.y"], 4000.0);
    assert!(said["duration_s"].as_f64().unwrap() > 2.0, "{said}");
}

#[test]
fn refusals_name_the_axis_the_field_and_its_range() {
    for (arguments, says) in [
        (&["jog", "scope.z=5000"][..], &["scope.z", "speed_um_s must lie between", "1000"][..]),
        (&["move", "scope.z=50", "--speed-um-s=-3"], &["speed_um_s must lie between"]),
        (&["move", "scope.z=50", "--speed-um-s", "1e9"], &["speed_um_s must lie between", "1000"]),
        (&["vibrate", "scope.z", "--amplitude-um", "0"], &["scope.z", "amplitude (µm) must lie between"]),
        (&["vibrate", "scope.z", "--frequency-hz", "1e6"], &["frequency (Hz) must lie between"]),
        (&["vibrate", "scope.z", "--cycles", "0"], &["cycles must lie between"]),
        (&["vibrate", "scope.z", "--amplitude-um", "500"], &["amplitude (µm) must lie between"]),
        (&["home", "m7.x"], &["this rig has no axis m7.x"]),
        (&["jog", "scope.x=10", "--for-s=-1"], &["--for-s", "between 0 and"]),
        (&["declare", "scope.z=1e12"], &["scope.z", "no position"]),
        (&["move", "scope.z=60", "--pulse-every-um", "0"], &["--pulse-every-um", "between 0.001"]),
        (&["move", "scope.z=60", "--pulse-every-um", "1e-4"], &["--pulse-every-um", "between 0.001"]),
        (&["move", "scope.z=60", "--pulse-every-um", "50"], &["no pulse lies between 40 and 60"]),
        (&["move", "scope.z=60", "--pulse-at-um", "70"], &["--pulse-at-um 70", "from 40 to 60"]),
        (&["move", "scope.z=60", "scope.x=3", "--pulse-at-um", "50"], &["--pulse-axis"]),
        (&["dfu"], &["--port"]),
        (&["--port", "sim", "dfu"], &["no bootloader"]),
    ] {
        let said = refused(arguments);
        assert!(says.iter().all(|s| said.contains(s)), "{arguments:?}: {said}");
    }
}

#[test]
fn settings_that_make_no_sense_are_refused_by_name() {
    for (changes, says) in [
        (&["steps_per_um=0"][..], "steps_per_um must lie between 0.001 and 10000"),
        (&["steps_per_um=nan"], "steps_per_um must lie between 0.001 and 10000"),
        (&["jerk_um_s3=inf"], "jerk_um_s3 must lie between"),
        (&["microsteps=0"], "microsteps must lie between 1 and 256"),
        (&["speed_um_s=1e9"], "speed_um_s must lie between"),
        (&["acceleration_um_s2=-1"], "acceleration_um_s2 must lie between"),
        (&["jerk_um_s3=0"], "jerk_um_s3 must lie between"),
        (&["low_um=10", "high_um=-10"], "high_um must lie between 10.001"),
        (&["low_um=-1e12"], "low_um"),
        (&["backlash_um=-1"], "backlash_um must lie between 0 and 1000"),
        (&["settling_ms=70000"], "settling_ms must lie between 0 and 60000"),
        (&["home_speed_um_s=5000"], "home_speed_um_s must lie between"),
        (&["home=sideways"], "home = sideways"),
        (&["driver=none"], "driver = none"),
    ] {
        let arguments: Vec<&str> = ["settings", "set", "scope.z"].iter().chain(changes).copied().collect();
        let said = refused(&arguments);
        assert!(said.contains("scope.z") || said.contains('='), "{changes:?}: {said}");
        assert!(said.contains(says), "{changes:?}: {said}");
    }
    for (change, says) in [
        ("host_timeout_ms=5", "host_timeout_ms must lie between 100 and 60000"),
        ("telemetry_hz=5000", "telemetry_hz must lie between 0 and 1000"),
    ] {
        let said = refused(&["settings", "set", "board", change]);
        assert!(said.contains(says), "{change}: {said}");
    }
}

#[test]
fn an_import_is_refused_with_the_axis_the_key_and_the_range() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("axes.toml");
    let name = file.to_str().unwrap();
    done(&["settings", "export", name]);
    let good = std::fs::read_to_string(&file).unwrap();
    done(&["settings", "import", name]);
    // The first axis of the file, by name, is m1.x.
    for (from, to, says) in [
        ("speed_um_s = 2000.0", "speed_um_s = -1.0", &["axes.m1.x", "speed_um_s must lie between"][..]),
        ("high_um = 10000.0", "high_um = -10000.0", &["axes.m1.x", "high_um must lie between"]),
        ("steps_per_um = 16.0", "steps_per_um = nan", &["axes.m1.x", "steps_per_um must lie between"]),
        ("steps_per_um = 16.0", "steps_per_mm = 16.0", &["steps_per_mm", "unknown field"]),
        ("schema = 1", "schema = 2", &["newer program"]),
        ("[axes.\"m1.x\"]", "[axes.\"m9.x\"]", &["m9.x"]),
        ("schema = 1", "schema = ", &["axes.toml"]),
    ] {
        assert!(good.contains(from), "{from} is not in\n{good}");
        std::fs::write(&file, good.replacen(from, to, 1)).unwrap();
        let said = refused(&["settings", "import", name]);
        assert!(says.iter().all(|s| said.contains(s)), "{to}: {said}");
    }
    assert!(refused(&["settings", "import", "nowhere.toml"]).contains("nowhere.toml"));
}

#[test]
fn usage_errors_are_told_apart() {
    for arguments in [
        &["jog", "scope.z"][..],
        &["jog", "scope.z=0"],
        &["jog", "scope.z=nan"],
        &["declare", "scope.z"],
        &["vibrate"],
        &["home"],
        &["move", "scope.z=1", "--pulse-from-um", "3"],
        &["move", "scope.z=1", "--no-wait", "--pulse-every-um", "3"],
    ] {
        let code = parfocal().args(arguments).output().unwrap().status.code();
        assert_eq!(code, Some(2), "{arguments:?}");
    }
}
