//! The same board behind a pseudo-terminal, with a real serial port in between.
#![cfg(unix)]

use parfocal_tests::{parfocal, parfocal_json};
use serde_json::Value;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Stdio};
use std::time::Duration;

/// `parfocal simulate --pty`, ended with the test.
struct Simulated {
    child: Child,
    ports: Vec<String>,
}

impl Simulated {
    fn start() -> Self {
        let mut child = parfocal()
            .args(["--json", "simulate", "--pty", "--boards", "1"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let said: Value = serde_json::from_str(&line).unwrap();
        let ports = said["ports"].as_array().unwrap().iter().map(|p| p.as_str().unwrap().to_string()).collect();
        Self { child, ports }
    }
}

impl Drop for Simulated {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn a_scan_through_a_serial_port_visits_the_same_places_as_in_the_simulator() {
    // The emulated board visits the same places of the same curve: emulator/src/scenarios/focus.rs.
    let golden = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("golden");
    let camera = format!("curve:{}", golden.join("curve.csv").display());
    let (code, simulated) = parfocal_json(&["autofocus", "--camera", &camera]);
    assert_eq!(code, 0, "{simulated}");
    let board = Simulated::start();
    let (code, real) = parfocal_json(&["--port", &board.ports[0], "autofocus", "--camera", &camera]);
    assert_eq!(code, 0, "{real}");
    for key in ["outcome", "z_um", "start_um", "travel_um", "frames", "samples"] {
        assert_eq!(simulated[key], real[key], "{key}");
    }
    let nm = |sample: &Value| (sample["z_um"].as_f64().unwrap() * 1000.0).round() as i64;
    let visited: Vec<i64> = real["samples"].as_array().unwrap().iter().map(nm).collect();
    let file = golden.join("scan.json");
    if std::env::var_os("REGENERATE").is_some() {
        std::fs::write(&file, serde_json::to_string(&visited).unwrap()).unwrap();
    }
    let expected: Vec<i64> = serde_json::from_str(&std::fs::read_to_string(file).unwrap()).unwrap();
    assert_eq!(visited, expected, "places changed: REGENERATE=1 writes the new ones, and the emulator must agree");
}

#[test]
fn a_sweep_through_a_serial_port_finds_the_peak() {
    let golden = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("golden/curve.csv");
    // Noise as a camera has it: without any, the jitter of real time alone would look like light that drifts.
    let camera = format!("curve:{}?noise=0.005&seed=1", golden.display());
    let board = Simulated::start();
    // Slow, for time is real here: frames lie less than 2 µm apart however busy the computer is.
    let sweep = ["autofocus", "--mode", "sweep", "--speed-um-s", "30", "--camera", &camera];
    let (code, said) = parfocal_json(&[&["--port", board.ports[0].as_str()][..], &sweep].concat());
    // The curve's highest point.
    let z = said["z_um"].as_f64().unwrap();
    assert!(code == 0 && (z - 17.0).abs() <= 1.5, "{said}");
}

#[test]
fn a_board_answers_one_program_at_a_time_and_the_next_one_after_it() {
    let board = Simulated::start();
    let port = board.ports[0].as_str();
    let (code, info) = parfocal_json(&["--port", port, "info"]);
    assert_eq!((code, info["boards"][0]["board"].as_str()), (0, Some("simulated")));
    let (code, moved) = parfocal_json(&["--port", port, "move", "scope.z=-20"]);
    assert_eq!((code, moved["positions_um"]["scope.z"].as_f64()), (0, Some(-20.0)));
    // Connecting moves and resets nothing.
    let (_, status) = parfocal_json(&["--port", port, "status"]);
    assert_eq!(status["axes"][2]["position_um"], -20.0);
}

/// One command on a port; its JSON.
fn on(port: &str, arguments: &[&str]) -> Value {
    let all: Vec<&str> = ["--port", port].iter().chain(arguments).copied().collect();
    let (code, said) = parfocal_json(&all);
    assert_eq!(code, 0, "{arguments:?}: {said}");
    said
}

#[test]
fn a_move_is_held_by_the_next_command_and_goes_on_with_another() {
    let board = Simulated::start();
    let port = board.ports[0].as_str();
    on(port, &["move", "scope.x=6000", "--no-wait"]);
    std::thread::sleep(Duration::from_millis(300));
    on(port, &["hold"]);
    std::thread::sleep(Duration::from_millis(400));
    let x = |status: Value| status["axes"][0]["position_um"].as_f64().unwrap();
    let held = x(on(port, &["status"]));
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(x(on(port, &["status"])), held, "a held axis rests");
    assert!(held > 0.0 && held < 6000.0, "{held}");
    on(port, &["resume"]);
    let mut still = (0..200).map(|_| {
        std::thread::sleep(Duration::from_millis(50));
        x(on(port, &["status"]))
    });
    assert!(still.any(|x| x == 6000.0), "it goes on to its end");
}

#[test]
fn a_home_switch_on_the_wrong_side_is_told() {
    let board = Simulated::start();
    let port = board.ports[0].as_str();
    // As if the motor turned the other way than the board thinks: the low switch is where it looks for the high one.
    on(port, &["settings", "set", "scope.z", "home=high", "inverted=true"]);
    let (code, said) = parfocal_json(&["--port", port, "home", "scope.z"]);
    let error = said["error"].as_str().unwrap();
    assert!(code == 1 && error.contains("scope.z") && error.contains("the other end's switch was met"), "{said}");
    // A switch that is wired, but reads the wrong way round, is pressed everywhere.
    let board = Simulated::start();
    let port = board.ports[0].as_str();
    on(port, &["settings", "set", "scope.z", "home=low", "inverted=false", "switches=pressed-low"]);
    let (code, said) = parfocal_json(&["--port", port, "home", "scope.z"]);
    assert!(code == 1 && said["error"].as_str().unwrap().contains("pressed everywhere"), "{said}");
    // None at all.
    on(port, &["settings", "set", "scope.x", "has_switches=false"]);
    let (code, said) = parfocal_json(&["--port", port, "home", "scope.x"]);
    assert!(code == 1 && said["error"].as_str().unwrap().contains("has no home switch in its settings"), "{said}");
}

#[test]
fn a_port_that_another_program_has_open_is_told_so() {
    let board = Simulated::start();
    let port = board.ports[0].as_str();
    let _other = serialport::new(port, 115_200).open().unwrap();
    let output = parfocal().args(["--port", port, "status"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(1) && said.contains(&format!("{port} is in use")), "{said}");
}

#[test]
fn a_port_without_a_board_is_told_so() {
    let (_master, far) = serialport::TTYPort::pair().unwrap();
    let name = serialport::SerialPort::name(&far).unwrap();
    drop(far);
    let output = parfocal().args(["--port", &name, "status"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1));
    assert!(said.contains(&name) && said.contains("answers as a Parfocal board"), "{said}");
}

/// Something on a port that answers every frame with one of another protocol version.
fn stranger(version: u8) -> (String, std::thread::JoinHandle<()>) {
    use serialport::SerialPort;
    use std::io::Read;
    let (mut board, far) = serialport::TTYPort::pair().unwrap();
    let name = far.name().unwrap();
    board.set_timeout(Duration::from_secs(5)).unwrap();
    let handle = std::thread::spawn(move || {
        let _far = far;
        let mut buffer = [0; 64];
        let mut frame = [0; parfocal_protocol::frame::MAX_FRAME];
        let n = parfocal_protocol::frame::encode_version(version, &0u8, &mut frame).unwrap();
        while let Ok(read) = board.read(&mut buffer) {
            if read > 0 && buffer[..read].contains(&0) && board.write_all(&frame[..n]).is_err() {
                break;
            }
        }
    });
    (name, handle)
}

#[test]
fn a_board_of_another_version_says_what_to_flash_or_update() {
    for (version, says) in [(0, "flash the board"), (9, "update this program")] {
        let (port, _thread) = stranger(version);
        let output = parfocal().args(["--port", &port, "status"]).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(1) && said.contains(says), "{version}: {said}");
    }
}
