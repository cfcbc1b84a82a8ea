//! What the rig's file knows of printed markers, on the page.

use crate::rig_file::{DATE, calibrated, known_by_its_marker};
use parfocal::rig::Rig;
use parfocal_tests::page::Served;
use serde_json::{Value, json};

#[test]
fn what_the_markers_say_is_shown_and_leads_to_the_search_for_a_tip() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    let mut rig = calibrated(&["40x", "20x", "4x"]);
    known_by_its_marker(&mut rig);
    rig.save(&path).unwrap();
    let mut served = Served::start(&["--rig", path.to_str().unwrap()]);
    served.take();
    served.until("pictures come", 90, |s| s["camera"]["health"] == "running");
    let known = &served.state()["calibrated"];
    assert_eq!(known["markers"], json!([["substrate", "0"], ["objective", "3"], ["m1", "1"]]));
    assert_eq!(known["coarse"], json!([{ "name": "m1", "error_um": 260.0, "error_deg": 0.4, "date": DATE }]));

    let before: Vec<Value> =
        served.state()["axes"].as_array().unwrap().iter().map(|a| a["position_um"].clone()).collect();

    // The weakest objective looks first: the page asks for it, and nothing moves before it is there.
    let start = |manipulator: &str| json!({ "what": "into-view", "by": "detector", "manipulator": manipulator });
    assert_eq!(served.post("/api/calibration/start", &start("m1")).status, 200);
    let state = served.until("an objective is asked for", 90, |s| !s["calibration"]["asked"].is_null());
    assert_eq!(state["calibration"]["title"], "m1 into view, through 4x, 20x, 40x");
    assert_eq!(
        (&state["calibration"]["asked"]["for"], &state["calibration"]["asked"]["subject"]),
        (&json!("objective"), &json!("4x"))
    );
    // A click is no answer to that.
    assert_eq!(served.post("/api/calibration/answer", &json!({ "x_px": 1.0, "y_px": 1.0 })).status, 422);
    let places = |s: &Value| s["axes"].as_array().unwrap().iter().map(|a| a["position_um"].clone()).collect::<Vec<_>>();
    let rests = |s: &Value| places(s) == before;
    assert!(rests(&state), "{}", state["axes"]);
    // Once it is, the search begins; ended here.
    assert_eq!(served.post("/api/calibration/answer", &json!({ "done": true })).status, 200);
    served.until("the turret is turned", 90, |s| s["calibrated"]["objective"] == "4x");
    served.until("it moves", 90, |s| !rests(s));
    assert_eq!(served.post("/api/cancel", &json!({})).status, 200);
    let state = served.until("it ends", 90, |s| s["calibration"]["over"] == true);
    assert_eq!(state["calibration"]["ready"], false);
    assert_eq!(Rig::load(&path).unwrap().contents().objective_in_use.as_deref(), Some("4x"), "as the turret stands");

    // One without a marker is told how to get one.
    served.post("/api/calibration/discard", &json!({}));
    served.until("all is at rest", 90, |s| s["activity"]["doing"] == "idle");
    let refused = served.post(
        "/api/calibration/start",
        &json!({ "what": "into-view", "by": "detector", "manipulator": "m2", "wait": true }),
    );
    let said = refused.json()["text"].as_str().unwrap_or_default().to_owned();
    assert!(refused.json()["ok"] == false && said.contains("calibrate coarse"), "{refused:?}");
}
