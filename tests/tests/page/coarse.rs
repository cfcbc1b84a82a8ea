//! What the rig's file knows of printed markers, on the page.

use parfocal::rig::{CameraCalibration, CoarseRegistration, ManipulatorNumber, Pipette, Record, Rig, Zoom};
use parfocal_simulator::model::{ObjectiveModel, RigModel};
use parfocal_tests::page::Served;
use serde_json::{Value, json};

const DATE: &str = "2026-11-26T00:00:00Z";

/// The simulated rig's file: camera and objectives calibrated, manipulator 1 known by its marker, 150 µm off.
fn file() -> Rig {
    let mut model = RigModel::new(0);
    model.objectives.push(ObjectiveModel::SEARCHER);
    let mut text = String::from("schema = 1\nobjective_in_use = \"40x\"\n[objectives.40x]\ndefault = true\n");
    text += "[camera]\nwidth_px = 640\nheight_px = 480\n";
    text += "[markers]\ntag_mm = 8.0\nsubstrate = 0\nobjective = 3\n[markers.manipulators]\nm1 = 1\n";
    for (i, device) in ["scope", "m1", "m2"].into_iter().enumerate() {
        text += &format!("[boards.{device}]\nunique_id = \"50462d73696d2d626f61723{}\"\n", i + 1);
        for (index, coordinate) in ["x", "y", "z"].into_iter().enumerate() {
            text += &format!("[axes.{device}.{coordinate}]\nboard = \"{device}\"\nindex = {index}\n");
            if device == "scope" {
                text += "moves = \"objective\"\n";
            }
        }
    }
    let mut rig = Rig::parse(&text).unwrap();
    let record = Record {
        date: DATE.into(),
        seed: 1,
        samples: "memory".into(),
        tolerance_um: 1.0,
        rms_um: 0.1,
        residuals_um: Vec::new(),
        rejected: Vec::new(),
    };
    let matrix_um_per_px = model.camera.matrix_um_per_px;
    rig.set_camera_calibration(CameraCalibration { matrix_um_per_px, objective: None, record }).unwrap();
    for o in &model.objectives {
        rig.set_zoom(o.name, Zoom { zoom: 1.0, alpha: o.alpha, kappa_um: o.kappa_um, record: None });
    }
    let m1 = &model.manipulators[0];
    let row = |r: usize| [m1.joints[r][0], m1.joints[r][1], m1.joints[r][2], m1.origin_um[r] + 150.0];
    let matrix = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
    let coarse = CoarseRegistration { matrix, error_um: 260.0, error_deg: 0.4, joints_um: [0.0; 3], date: DATE.into() };
    let (descent_deg, azimuth_deg) = (m1.descent_rad.to_degrees(), m1.azimuth_rad.to_degrees());
    let pipette = Pipette { descent_deg, azimuth_deg, source: parfocal::rig::MARKERS.into(), date: DATE.into() };
    rig.set_coarse(ManipulatorNumber::new(1).unwrap(), coarse, Some(pipette));
    rig
}

#[test]
fn what_the_markers_say_is_shown_and_leads_to_the_search_for_a_tip() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    file().save(&path).unwrap();
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
