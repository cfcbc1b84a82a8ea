//! Cameras that die, stall or change, as the page tells of them.
#![cfg(unix)]

use parfocal_tests::page::Served;
use serde_json::json;

/// A camera of `width` x 4 that delivers `count` frames and then does `rest`.
fn camera(width: usize, count: usize, rest: &str) -> String {
    let body = "0123456789abcdef".repeat(width * 4 / 16);
    format!(
        "echo 'YUV4MPEG2 W{width} H4 F30:1 Cmono'; for i in $(seq {count}); do printf 'FRAME\\n{body}'; sleep 0.02; done; {rest}"
    )
}

#[test]
fn a_camera_that_dies_is_told_and_restarted_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let mark = folder.path().join("second");
    let (mark, frames) = (mark.display(), camera(16, 400, "true"));
    let command =
        format!("exec:if [ -e {mark} ]; then {frames}; else touch {mark}; echo the lamp is off >&2; exit 1; fi");
    let mut served = Served::start(&["--camera", &command]);
    let state = served.until("it is told", 90, |s| s["camera"]["health"] == "failed");
    assert!(state["camera"]["problem"].as_str().unwrap().contains("the lamp is off"), "{}", state["camera"]);
    // Axes move all the same; focusing says why it cannot.
    served.take();
    assert_eq!(served.post("/api/move", &json!({ "to_um": { "scope.z": 1.0 }, "wait": true })).json()["ok"], true);
    let scan = served.post("/api/autofocus", &json!({ "wait": true })).json();
    assert!(scan["ok"] == false && scan["text"].as_str().unwrap().contains("the lamp is off"), "{scan}");
    assert_eq!(served.post("/api/camera/restart", &json!({})).status, 200);
    let state = served.until("it runs", 90, |s| s["camera"]["health"] == "running");
    assert_eq!((state["camera"]["width_px"].as_u64(), state["camera"]["height_px"].as_u64()), (Some(16), Some(4)));
}

#[test]
fn a_camera_that_stalls_is_told() {
    let served = Served::start(&["--camera", &format!("exec:{}", camera(16, 3, "sleep 100"))]);
    let state = served.until("it is told", 90, |s| s["camera"]["health"] == "failed");
    assert!(state["camera"]["problem"].as_str().unwrap().contains("delivered no frame"), "{}", state["camera"]);
}

#[test]
fn frames_that_change_their_size_are_told() {
    let command = format!("exec:{}; {}", camera(16, 3, "true"), camera(32, 3, "sleep 5"));
    let served = Served::start(&["--camera", &command]);
    let state = served.until("it is told", 90, |s| s["camera"]["health"] == "failed");
    assert!(state["camera"]["problem"].as_str().unwrap().contains("from 16x4 to 32x4"), "{}", state["camera"]);
}

#[test]
fn what_is_no_camera_is_told_before_anything_starts() {
    for (camera, says) in
        [("usb:0", "exec:COMMAND"), ("stack:/no/such/folder", "/no/such/folder"), ("curve:x.csv", "without pictures")]
    {
        let output =
            parfocal_tests::parfocal().args(["serve", "--listen", "127.0.0.1:0", "--camera", camera]).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(says), "{camera}: {said}");
    }
}
