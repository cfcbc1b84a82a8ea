//! What must be refused is refused, nothing moves, nothing panics.

use parfocal_tests::http::send;
use parfocal_tests::page::Served;
use parfocal_tests::parfocal;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use serde_json::{Value, json};
use tungstenite::Message;

/// Every path that changes something, with a body that would be carried out.
fn posts() -> Vec<(&'static str, Value)> {
    vec![
        ("/api/control", json!({ "name": "x" })),
        ("/api/stop", json!({})),
        ("/api/cancel", json!({})),
        ("/api/move", json!({ "to_um": { "scope.x": 100.0, "m1.z": 5.0 }, "relative": true, "speed_um_s": 50.0 })),
        ("/api/jog", json!({ "axis": "scope.y", "speed_um_s": 100.0 })),
        ("/api/click", json!({ "device": "scope", "x_px": 10.0, "y_px": 10.0 })),
        (
            "/api/autofocus",
            json!({ "axis": "scope.z", "range_um": [-5.0, 5.0], "sample_step_um": 0.5, "strategy": "climb" }),
        ),
        ("/api/look", json!({ "measure": "brenner", "region": { "x": 1, "y": 1, "width": 40, "height": 40 } })),
        ("/api/objective", json!({ "name": "20x" })),
        ("/api/camera/restart", json!({})),
        ("/api/emergency/clear", json!({})),
        ("/api/calibration/start", json!({ "what": "camera", "by": "click", "places": 4 })),
        ("/api/calibration/answer", json!({ "x_px": 1.0, "y_px": 2.0 })),
        ("/api/calibration/undo", json!({ "sample": 0 })),
        ("/api/calibration/accept", json!({})),
        ("/api/calibration/discard", json!({})),
    ]
}

fn positions(served: &Served) -> Vec<Value> {
    // Every board was heard, or null would count as a place.
    let known = |s: &Value| s["axes"].as_array().unwrap().iter().all(|axis| axis["position_um"].is_number());
    served.until("the boards are heard", 90, known)["axes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|axis| axis["position_um"].clone())
        .collect()
}

/// Nothing moved since, and nothing broke.
fn unharmed(served: &mut Served, before: &[Value]) {
    let state = served.state();
    assert_eq!(state["activity"]["id"], 0, "nothing began: {}", state["activity"]);
    assert_eq!(positions(served), before);
    assert!(served.runs() && !served.complaints().contains("panicked"), "{}", served.complaints());
}

#[test]
fn other_pages_and_other_names_move_nothing() {
    let mut served = Served::start(&[]);
    served.take();
    let before = positions(&served);
    let (address, key) = (served.address.clone(), served.key.clone());
    let port = address.rsplit(':').next().unwrap();
    let own = format!("http://{address}");
    let (rebound, other_port) = (format!("evil.example:{port}"), format!("http://127.0.0.1:{}", 1));
    let bad: Vec<Vec<(&str, &str)>> = vec![
        vec![("origin", "http://evil.example")],
        vec![("origin", "null")],
        vec![("origin", other_port.as_str())],
        vec![("host", rebound.as_str())],
        vec![("host", rebound.as_str()), ("origin", own.as_str())],
        vec![("host", "")],
        vec![("sec-fetch-site", "cross-site")],
        vec![("sec-fetch-site", "same-site")],
    ];
    for extra in &bad {
        for (path, body) in posts() {
            let mut headers = vec![("content-type", "application/json"), ("x-parfocal-key", key.as_str())];
            headers.extend(extra);
            let answer = send(&address, "POST", path, &headers, body.to_string().as_bytes());
            assert!(answer.status == 403 || answer.status == 400, "{path} {extra:?}: {}", answer.head);
        }
        for path in ["/", "/api/state", "/api/frame.jpg"] {
            let status = send(&address, "GET", path, extra, b"").status;
            assert!(status == 403 || status == 400, "{path} {extra:?}: {status}");
        }
        // The WebSocket is judged by the same rules.
        let mut request =
            tungstenite::client::IntoClientRequest::into_client_request(format!("ws://{address}/api/live")).unwrap();
        for (name, value) in extra {
            request.headers_mut().insert(
                tungstenite::http::HeaderName::from_bytes(name.as_bytes()).unwrap(),
                tungstenite::http::HeaderValue::from_str(value).unwrap(),
            );
        }
        assert!(tungstenite::connect(request).is_err(), "{extra:?}");
    }
    // What a form of a foreign page can send without asking first: no JSON.
    for kind in ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data"] {
        let headers = [("content-type", kind), ("x-parfocal-key", key.as_str())];
        let answer = send(&address, "POST", "/api/move", &headers, br#"{"to_um":{"scope.x":10}}"#);
        assert_eq!(answer.status, 415, "{kind}");
    }
    unharmed(&mut served, &before);
}

#[test]
fn a_wrong_token_opens_nothing_and_the_right_one_everything() {
    let token = "0123456789abcdef0123";
    let mut served = Served::start(&["--token", token]);
    let address = served.address.clone();
    for headers in
        [vec![], vec![("authorization", "Bearer 0123456789abcdef0124")], vec![("cookie", "parfocal_token=x")]]
    {
        for (path, body) in posts() {
            let mut headers = headers.clone();
            headers.push(("content-type", "application/json"));
            assert_eq!(send(&address, "POST", path, &headers, body.to_string().as_bytes()).status, 401, "{path}");
        }
        for path in ["/", "/main.js", "/api/state", "/api/live", "/?token=0123456789abcdef0124"] {
            assert_eq!(send(&address, "GET", path, &headers, b"").status, 401, "{path}");
        }
    }
    assert!(served.runs());
    let opened = send(&address, "GET", &format!("/?token={token}"), &[], b"");
    let cookie =
        opened.head.lines().find_map(|l| l.strip_prefix("set-cookie: ")).unwrap_or_else(|| panic!("{}", opened.head));
    assert!(opened.status == 303 && cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"), "{cookie}");
    let cookie = cookie.split(';').next().unwrap();
    assert_eq!(send(&address, "GET", "/api/state", &[("cookie", cookie)], b"").status, 200);
    let bearer = format!("Bearer {token}");
    assert_eq!(send(&address, "GET", "/", &[("authorization", &bearer)], b"").status, 200);
}

#[test]
fn an_address_that_others_reach_is_refused_without_a_token() {
    let output = parfocal().args(["serve", "--listen", "0.0.0.0:0"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(1) && said.contains("--token"), "{said}");
    let output = parfocal().args(["serve", "--listen", "0.0.0.0:0", "--token", "short"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
}

/// A value of no particular meaning.
fn anything() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<i64>().prop_map(Value::from),
        any::<f64>().prop_map(Value::from),
        ".{0,12}".prop_map(Value::from),
        Just(json!("scope.x")),
        Just(json!(1e308)),
    ];
    leaf.prop_recursive(3, 12, 4, |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
            prop::collection::btree_map("[a-z_]{1,8}", inner, 0..4)
                .prop_map(|m| Value::from(serde_json::Map::from_iter(m))),
        ]
    })
}

#[test]
fn ten_thousand_random_bodies_are_refused_and_move_nothing() {
    let mut served = Served::start(&[]);
    served.take();
    let before = positions(&served);
    let posts = posts();
    let mut runner = TestRunner::deterministic();
    let (bytes, value) = (prop::collection::vec(any::<u8>(), 0..80), anything());
    let (key, kind) = (served.key.clone(), ("content-type", "application/json"));
    for i in 0..10_000 {
        let (path, good) = &posts[i % posts.len()];
        // Noise, JSON of no meaning, a good body cut short, or with one key that is not known.
        let body: Vec<u8> = match i / posts.len() % 4 {
            0 => bytes.new_tree(&mut runner).unwrap().current(),
            1 => json!({ "no_such_key": value.new_tree(&mut runner).unwrap().current() }).to_string().into_bytes(),
            2 => {
                let text = good.to_string();
                text.as_bytes()[..text.len() - 1 - i % (text.len() - 1)].to_vec()
            }
            _ => {
                let mut mixed = good.clone();
                mixed["no_such_key"] = value.new_tree(&mut runner).unwrap().current();
                mixed.to_string().into_bytes()
            }
        };
        let answer = send(&served.address, "POST", path, &[kind, ("x-parfocal-key", key.as_str())], &body);
        let shown = String::from_utf8_lossy(&body).into_owned();
        assert!((400..500).contains(&answer.status), "{path} {shown:?}: {} {}", answer.status, answer.head);
        assert!(answer.json()["error"].is_string(), "{path} {shown:?}: a sentence, not {answer:?}");
    }
    unharmed(&mut served, &before);
    // Too long is refused as well.
    let long = format!("{{\"name\":\"{}\"}}", "x".repeat(100_000));
    let answer = send(&served.address, "POST", "/api/control", &[kind], long.as_bytes());
    assert!(answer.status == 413 || answer.status == 0, "{answer:?}");
    unharmed(&mut served, &before);
}

#[test]
fn impossible_values_are_refused_in_words() {
    let mut served = Served::start(&[]);
    served.take();
    served.until("pictures come", 90, |s| s["camera"]["health"] == "running");
    let before = positions(&served);
    for (path, body, says) in [
        ("/api/move", json!({ "to_um": { "scope.z": 1e9 } }), "scope.z"),
        ("/api/move", json!({ "to_um": { "scope.z": 500.0 } }), "only go from -200 to 200"),
        ("/api/move", json!({ "to_um": {} }), "at least one axis"),
        ("/api/move", json!({ "to_um": { "scope.w": 1.0 } }), "is not an axis"),
        ("/api/move", json!({ "to_um": { "m7.x": 1.0 } }), "no axis m7.x"),
        ("/api/move", json!({ "to_um": { "scope.x": 1.0 }, "speed_um_s": 0.0 }), "above 0"),
        ("/api/jog", json!({ "axis": "scope.x", "speed_um_s": 1e30 }), "speed"),
        ("/api/jog", json!({ "axis": "scope.x", "speed_um_s": 1e300 }), "no speed"),
        ("/api/click", json!({ "device": "scope", "x_px": 5000.0, "y_px": 1.0 }), "not in the picture"),
        ("/api/click", json!({ "device": "scope", "x_px": 1.0, "y_px": 1.0 }), "calibrate"),
        ("/api/look", json!({ "region": { "x": 630, "y": 0, "width": 20, "height": 20 } }), "leaves the picture"),
        ("/api/look", json!({ "region": { "x": 0, "y": 0, "width": 2, "height": 2 } }), "3x3"),
        ("/api/autofocus", json!({ "axis": "scope.z", "range_um": [300.0, 400.0] }), "leaves nothing"),
        ("/api/autofocus", json!({ "axis": "m9.z" }), "no axis m9.z"),
        ("/api/calibration/answer", json!({ "x_px": 1.0, "y_px": 1.0 }), "nothing is asked"),
        ("/api/calibration/accept", json!({}), "no calibration"),
        ("/api/calibration/start", json!({ "what": "registration", "by": "click" }), "manipulator"),
        ("/api/calibration/start", json!({ "what": "objective", "by": "click" }), "calibrate the camera first"),
        ("/api/calibration/start", json!({ "what": "objective", "by": "click", "through": ["7x"] }), "'7x'"),
        (
            "/api/calibration/start",
            json!({ "what": "into-view", "by": "click", "manipulator": "m1", "through": ["4x"] }),
            "not calibrated",
        ),
        ("/api/calibration/answer", json!({ "done": true }), "no objective is asked"),
        ("/api/objective", json!({ "name": "7x" }), "it has 20x, 40x, 4x"),
        ("/api/objective", json!({ "name": "40x", "new": true }), "known already"),
        ("/api/objective", json!({ "name": " ", "new": true }), "1 to 40 characters"),
    ] {
        let answer = served.post(path, &body);
        let said = answer.json()["error"].as_str().unwrap_or_default().to_owned();
        assert!((400..500).contains(&answer.status) && said.contains(says), "{path} {body}: {} {said}", answer.status);
    }
    unharmed(&mut served, &before);
}

#[test]
fn malformed_messages_close_the_websocket_and_move_nothing() {
    let mut served = Served::start(&[]);
    served.take();
    let before = positions(&served);
    let jog = json!({ "type": "jog", "key": served.key, "axis": "scope.x", "speed_um_s": 100.0 });
    let with = |key: &str, value: Value| {
        let mut message = jog.clone();
        message[key] = value;
        Message::text(message.to_string())
    };
    for message in [
        Message::text("{"),
        Message::text("[]"),
        Message::text("{\"type\":\"fly\"}"),
        Message::binary(vec![0; 10]),
        Message::text("x".repeat(20_000)),
        with("axis", json!("scope.q")),
        with("speed_um_s", json!("fast")),
        with("extra", json!(1)),
    ] {
        let (mut socket, _) = tungstenite::connect(format!("ws://{}/api/live", served.address)).unwrap();
        socket.send(message.clone()).unwrap();
        let closed = (0..200).any(|_| !matches!(socket.read(), Ok(Message::Text(_) | Message::Binary(_))));
        assert!(closed, "{message:?}");
    }
    // A jog with a wrong key is answered, and not carried out.
    let (mut socket, _) = tungstenite::connect(format!("ws://{}/api/live", served.address)).unwrap();
    socket.send(with("key", json!("0"))).unwrap();
    let refused = (0..200).any(|_| matches!(socket.read(), Ok(Message::Text(text)) if text.contains("\"refused\"")));
    assert!(refused);
    unharmed(&mut served, &before);
}
