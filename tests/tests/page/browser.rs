//! The operator page in a real browser, against the simulated rig: what a person does and sees.

use crate::rig_file::calibrated;
use parfocal_simulator::model::RigModel;
use parfocal_tests::page::Served;
use parfocal_tests::webdriver::Browser;
use serde_json::{Value, json};

/// How long anything may take, s: only a failure takes it.
const PATIENCE: u64 = 180;
/// A camera that delivers sooner than the usual one: a scan waits for frames most of its time.
const FAST: [&str; 2] = ["--camera", "sim?fps=75&exposure_ms=2&delay_ms=1..2"];
/// What the page says of who has control.
const YOURS: &str = "return document.getElementById('operator').innerText === 'you have control'";

/// A page in a browser, with control.
fn page(arguments: &[&str]) -> Option<(Served, Browser)> {
    let browser = Browser::start()?;
    let served = Served::start(arguments);
    browser.open(&format!("http://{}/", served.address));
    browser.until(YOURS, PATIENCE);
    browser.until("return Number(document.documentElement.dataset.frame) > 2", PATIENCE);
    // The picture may be there before the boards are.
    let known = |s: &Value| s["axes"].as_array().unwrap().iter().all(|axis| axis["position_um"].is_number());
    served.until("all boards were heard", PATIENCE, |s| known(s) && s["activity"]["doing"] == "idle");
    Some((served, browser))
}

/// Where a pixel of the picture is in the window.
fn on_screen(browser: &Browser, x: f64, y: f64) -> (f64, f64) {
    let script = format!(
        "const b = document.getElementById('view').getBoundingClientRect(); const z = Math.min(b.width / 640, b.height / 480);
         return [b.x + b.width / 2 + ({x} - 319.5) * z, b.y + b.height / 2 + ({y} - 239.5) * z]"
    );
    let at = browser.run(&script);
    (at[0].as_f64().unwrap(), at[1].as_f64().unwrap())
}

/// Drags the focus region around the first pipette's tip, where the simulated rig has it.
fn region_around_the_tip(browser: &Browser) {
    browser.click("#tool-region");
    let (from, to) = (on_screen(browser, 255.0, 203.0), on_screen(browser, 303.0, 251.0));
    browser.drag(&[from, ((from.0 + to.0) / 2.0, (from.1 + to.1) / 2.0), to]);
}

#[test]
fn a_jog_goes_on_while_the_button_is_held_and_stop_ends_a_move() {
    let Some((served, browser)) = page(&[]) else { return };
    let before = served.position("scope.x").unwrap();
    browser.press("#jog-scope\\.x-up");
    served.until("the axis moves", PATIENCE, |s| s["activity"]["doing"] == "jog" && s["axes"][0]["moving"] == true);
    browser.screenshot("jog");
    served.until("it goes on while held", PATIENCE, |s| s["axes"][0]["position_um"].as_f64().unwrap() > before + 30.0);
    browser.release();
    let state =
        served.until("it ends", PATIENCE, |s| s["activity"]["doing"] == "idle" && s["axes"][0]["moving"] == false);
    let there = state["axes"][0]["position_um"].as_f64().unwrap();
    // By key, the other way; the page losing the focus would end it as well.
    browser.run("document.activeElement.blur()");
    browser.hold_key("\u{E012}", true);
    served.until("it comes back", PATIENCE, |s| s["axes"][0]["position_um"].as_f64().unwrap() < there - 20.0);
    browser.hold_key("\u{E012}", false);
    served.until("it ends", PATIENCE, |s| s["activity"]["doing"] == "idle" && s["axes"][0]["moving"] == false);

    // A long move, typed in; stopped on its way by Space.
    browser.click("#place-scope\\.y");
    browser.run("document.activeElement.value = '5000'");
    browser.key("\u{E007}");
    served.until("it moves", PATIENCE, |s| {
        s["axes"][1]["moving"] == true && s["axes"][1]["position_um"].as_f64().unwrap() > 100.0
    });
    browser.key(" ");
    let state =
        served.until("it stops", PATIENCE, |s| s["activity"]["doing"] == "idle" && s["axes"][1]["moving"] == false);
    let y = state["axes"][1]["position_um"].as_f64().unwrap();
    assert!(y > 100.0 && y < 4500.0, "stopped in mid-move, at {y}");
    assert_ne!(state["axes"][1]["trust"], "lost");
    browser.until("return document.getElementById('messages').innerText.includes('STOP')", PATIENCE);
    browser.screenshot("stopped");
}

#[test]
fn autofocus_finds_the_tip_and_its_curve_is_on_the_screen() {
    let Some((served, browser)) = page(&[]) else { return };
    region_around_the_tip(&browser);
    let state = served.until("the region is set", PATIENCE, |s| !s["focus"]["region"].is_null());
    let region = &state["focus"]["region"];
    assert!(
        (region["x"].as_f64().unwrap() - 255.0).abs() < 4.0 && (region["width"].as_f64().unwrap() - 48.0).abs() < 5.0,
        "{region}"
    );
    // Near focus, as a person would begin.
    let moved = by_page(&browser, "move", json!({ "to_um": { "scope.z": 12.0 }, "wait": true }));
    assert_eq!(moved["ok"], true, "{moved}");
    browser.run("document.getElementById('range').value = '25'");
    browser.click("#autofocus");
    served.until("it scans", PATIENCE, |s| s["focus"]["samples"].as_u64() > Some(15));
    // In mid-scan the page is loaded again: the scan goes on, the curve is there whole, control as well.
    browser.screenshot("scan");
    browser.reload();
    browser.until("return document.getElementById('operator').innerText === 'you have control'", PATIENCE);
    let state = served.until("the scan ends", PATIENCE, |s| s["activity"]["doing"] == "idle");
    let z = state["axes"][2]["position_um"].as_f64().unwrap();
    assert_eq!(state["focus"]["refused"], json!(null), "{state}");
    assert!(z.abs() < 2.0, "the first tip lies at 0 µm, the focus was found at {z}");
    let drawn =
        format!("return Number(document.getElementById('curve').dataset.samples) === {}", state["focus"]["samples"]);
    browser.until(&drawn, PATIENCE);
    browser.until("return document.getElementById('focus-result').innerText.includes('in focus at')", PATIENCE);
    browser.screenshot("focused");
    assert_eq!(errors(&browser), Vec::<String>::new(), "nothing goes wrong in the page itself");
}

/// Where the first pipette's tip truly shows: by the simulated rig's own geometry, of which the page knows nothing.
fn tip_px(state: &Value) -> (f64, f64) {
    let model = RigModel::new(0);
    let at = |name: &str| {
        let axes = state["axes"].as_array().unwrap();
        axes.iter().find(|axis| axis["name"] == name).unwrap()["position_um"].as_f64().unwrap()
    };
    let objective = model.objectives.iter().find(|o| state["calibrated"]["objective"] == o.name).unwrap();
    let tip = model.manipulators[0].tip(["m1.x", "m1.y", "m1.z"].map(at));
    let [[a, b], [c, d]] = model.camera.matrix_um_per_px;
    let x = (tip[0] - at("scope.x") - objective.kappa_um[0]) / objective.alpha;
    let y = (tip[1] - at("scope.y") - objective.kappa_um[1]) / objective.alpha;
    let determinant = a * d - b * c;
    (319.5 + (d * x - b * y) / determinant, 239.5 + (a * y - c * x) / determinant)
}

/// Clicks on the tip whenever the page asks for it, and says yes to objectives, until the procedure is over and the page shows that.
fn click_through(served: &Served, browser: &Browser) -> Value {
    let mut clicks = 0;
    loop {
        let state = served.until("a question or the end", PATIENCE, |s| {
            !s["calibration"]["asked"].is_null() || s["calibration"]["over"] == true
        });
        if state["calibration"]["over"] == true {
            assert!(clicks >= 6, "{state}");
            browser.until("return document.getElementById('calibration').dataset.over === 'true'", PATIENCE);
            return served.state();
        }
        let question = &state["calibration"]["asked"]["n"];
        // The page may be behind: a click before it shows this question would be another question's.
        let shown = format!("return document.getElementById('calibration').dataset.question === '{question}'");
        browser.until(&shown, PATIENCE);
        if state["calibration"]["asked"]["for"] == "objective" {
            browser.screenshot("objective");
            browser.click("#changed");
        } else {
            browser.until(
                "return document.getElementById('tool-click')?.getAttribute('aria-checked') === 'true'",
                PATIENCE,
            );
            let (x, y) = tip_px(&state);
            browser.click_at(on_screen(browser, x, y));
            clicks += 1;
        }
        // It is taken once the question is gone or another one.
        served.until("the answer is taken", PATIENCE, |s| s["calibration"]["asked"]["n"] != *question);
        if clicks == 5 {
            browser.screenshot("clicking");
        }
        assert!(clicks < 60, "{}", served.state());
    }
}

/// Few places, and how far off their focus may be, µm.
fn set_fields(browser: &Browser, within: u32) {
    for (field, value) in [("places", 3), ("within", within)] {
        browser.run(&format!(
            "const f = document.getElementById('{field}'); f.value = {value}; f.dispatchEvent(new Event('change'))"
        ));
    }
}

#[test]
fn camera_and_manipulator_are_calibrated_by_clicks() {
    let Some((served, browser)) = page(&FAST) else { return };
    // Near focus, as a person would begin.
    let moved = by_page(&browser, "move", json!({ "to_um": { "scope.z": 1.0 }, "wait": true }));
    assert_eq!(moved["ok"], true, "{moved}");
    // Objectives wait for the camera.
    browser.click("#step-objective");
    assert_eq!(browser.run("return document.getElementById('begin').disabled"), true);
    browser.click("#step-camera");
    set_fields(&browser, 12);
    browser.click("#begin");
    let state = click_through(&served, &browser);
    assert_eq!(state["calibration"]["ready"], true, "{}", state["calibration"]);
    // A sample is taken back and in again; the solution follows.
    browser.click("#undo");
    served.until("it is undone", PATIENCE, |s| {
        s["calibration"]["samples"].as_array().unwrap().iter().any(|r| r["undone"] == true)
    });
    let last = state["calibration"]["samples"].as_array().unwrap().len() - 1;
    // The page hears of it a moment later than whoever asks; until then its button still means the opposite.
    browser.until(&format!("return document.getElementById('undo-{last}').textContent === 'Take in again'"), PATIENCE);
    browser.click(&format!("#undo-{last}"));
    let state = served.until("it is in again", PATIENCE, |s| {
        s["calibration"]["samples"].as_array().unwrap().iter().all(|r| r["undone"] == false)
    });
    assert!(state["calibration"]["rms_um"].as_f64().unwrap() < 0.3, "{}", state["calibration"]);
    browser.screenshot("camera");
    browser.click("#accept");
    let state = served.until("the camera is calibrated", PATIENCE, |s| s["calibrated"]["camera"] == true);
    let size = state["calibrated"]["pixel_um"][0].as_f64().unwrap();
    assert!((size - 0.323).abs() < 0.005, "{size}");

    browser.click("#step-m1");
    // The tip's focus moves along when a manipulator goes up or down.
    set_fields(&browser, 30);
    browser.click("#begin");
    let state = click_through(&served, &browser);
    assert_eq!(state["calibration"]["ready"], true, "{}", state["calibration"]);
    browser.screenshot("registration");
    browser.click("#accept");
    let state = served.until("the tip is known", PATIENCE, |s| s["tips"].as_array().unwrap().len() == 1);
    let (x, y) = tip_px(&state);
    let tip = &state["tips"][0];
    let off = (tip["x_px"].as_f64().unwrap() - x).hypot(tip["y_px"].as_f64().unwrap() - y);
    assert!(off < 3.0, "the tip is drawn {off} px from where it is");

    // And used: the tip goes where the person clicks.
    browser.until("return document.getElementById('tool-to-m1') !== null", PATIENCE);
    browser.click("#tool-to-m1");
    browser.click_at(on_screen(&browser, 400.0, 150.0));
    served.until("it moves", PATIENCE, |s| {
        s["activity"]["doing"] == "move" || s["activity"]["ended"][0]["text"] == "in position"
    });
    let state = served.until("it is there", PATIENCE, |s| s["activity"]["doing"] == "idle");
    let (x, y) = tip_px(&state);
    assert!((x - 400.0).hypot(y - 150.0) < 4.0, "the tip went to {x}, {y}");
    browser.screenshot("tip");
    assert_eq!(errors(&browser), Vec::<String>::new());
}

#[test]
#[ignore = "five and a half minutes in real time, most of it scans through 20x; auto/heights.rs shows the same in virtual time"]
fn objectives_are_calibrated_by_clicks_and_changed_on_the_page() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    calibrated(&["40x"]).save(&path).unwrap();
    let arguments = [&FAST[..], &["--rig", path.to_str().unwrap()]].concat();
    let Some((served, browser)) = page(&arguments) else { return };
    let moved = by_page(&browser, "move", json!({ "to_um": { "scope.z": 1.0 }, "wait": true }));
    assert_eq!(moved["ok"], true, "{moved}");

    browser.click("#step-objective");
    // What the other objective focuses on lies 3 µm off, and its peak is wide.
    set_fields(&browser, 30);
    browser.click("#through-20x");
    browser.click("#begin");
    let state = click_through(&served, &browser);
    assert_eq!(state["calibration"]["ready"], true, "{}", state["calibration"]);
    assert_eq!(state["calibrated"]["objective"], "20x");
    browser.screenshot("objectives");
    browser.click("#accept");
    let known = |s: &Value| {
        let all = s["calibrated"]["objectives"].as_array().unwrap();
        all.iter().find(|o| o["name"] == "20x").unwrap().clone()
    };
    let state = served.until("the objective is calibrated", PATIENCE, |s| !known(s)["alpha"].is_null());
    let truth = RigModel::new(0).objectives[1];
    let found = known(&state);
    assert!((found["alpha"].as_f64().unwrap() / truth.alpha - 1.0).abs() < 0.005, "{found}");
    let off = (0..3).map(|i| (found["kappa_um"][i].as_f64().unwrap() - truth.kappa_um[i]).abs()).fold(0.0, f64::max);
    assert!(off < 1.0, "{found}, truly {:?}", truth.kappa_um);

    // Back to the other one, by the list above the picture; the page asks before it turns the turret.
    browser.run("window.confirm = () => true");
    browser
        .run("const o = document.getElementById('objective'); o.value = '40x'; o.dispatchEvent(new Event('change'))");
    served.until("the turret is turned", PATIENCE, |s| s["calibrated"]["objective"] == "40x");
    assert_eq!(errors(&browser), Vec::<String>::new());
    let kept = parfocal::rig::Rig::load(&path).unwrap();
    assert_eq!(kept.contents().objective_in_use.as_deref(), Some("40x"));
    assert_eq!(kept.contents().objectives["20x"].zooms.len(), 1);
}

#[test]
fn a_duplicated_tab_watches_and_its_twin_keeps_control() {
    let Some((served, browser)) = page(&[]) else { return };
    let first = browser.duplicate();
    browser.until("return document.getElementById('operator').innerText.includes('in another window')", PATIENCE);
    assert_eq!(browser.run("return sessionStorage.getItem('parfocal-key')"), Value::Null);
    assert_eq!(browser.run("return document.getElementById('autofocus').disabled"), true);
    browser.look_at(&first);
    assert_eq!(by_page(&browser, "move", json!({ "to_um": { "scope.x": 5.0 }, "wait": true }))["ok"], true);
    browser.until(YOURS, PATIENCE);
    // Loaded again it is still the operator's: nobody else holds its key.
    browser.reload();
    browser.until(YOURS, PATIENCE);
    assert!(served.state()["operator"].is_string());
}

/// Asks the server as the page does, with the page's own key.
fn by_page(browser: &Browser, path: &str, body: Value) -> Value {
    let script = format!(
        "const a = await fetch('/api/{path}', {{ method: 'POST', body: JSON.stringify({body}),
           headers: {{ 'content-type': 'application/json', 'x-parfocal-key': sessionStorage.getItem('parfocal-key') }} }});
         return await a.json()"
    );
    browser.run(&format!("return (async () => {{ {script} }})()"))
}

/// What the page's console complains of.
fn errors(browser: &Browser) -> Vec<String> {
    let log = browser.log();
    let grave = log.as_array().into_iter().flatten().filter(|entry| entry["level"] == "SEVERE");
    grave.map(|entry| entry["message"].as_str().unwrap_or_default().to_owned()).collect()
}
