//! One operator, many who watch; jogs that nobody holds any more; STOP for everyone.

use parfocal_tests::http::send;
use parfocal_tests::page::Served;
use serde_json::json;
use std::net::TcpStream;
use std::time::Duration;
use tungstenite::{Message, WebSocket};

fn live(served: &Served) -> WebSocket<TcpStream> {
    let stream = TcpStream::connect(&served.address).unwrap();
    tungstenite::client(format!("ws://{}/api/live", served.address), stream).unwrap().0
}

fn jog(socket: &mut WebSocket<TcpStream>, key: &str, speed: f64) {
    let message = json!({ "type": "jog", "key": key, "axis": "scope.x", "speed_um_s": speed });
    socket.send(Message::text(message.to_string())).unwrap();
}

/// Keeps jogging until the axis is on its way.
fn under_way(served: &Served, socket: &mut WebSocket<TcpStream>) {
    let before = served.position("scope.x").unwrap();
    for _ in 0..200 {
        jog(socket, &served.key, 200.0);
        std::thread::sleep(Duration::from_millis(30));
        if served.position("scope.x").unwrap() > before + 20.0 {
            return;
        }
    }
    panic!("the axis does not jog: {}", served.state());
}

#[test]
fn a_jog_ends_when_its_page_is_gone() {
    let mut served = Served::start(&[]);
    served.take();
    for how in ["closed", "silent"] {
        let mut socket = live(&served);
        under_way(&served, &mut socket);
        if how == "closed" {
            drop(socket);
            let state = served.until("the jog ends", 90, |s| s["activity"]["doing"] == "idle");
            assert_eq!(state["axes"][0]["moving"], false);
        } else {
            // A page that hangs: connected, and asking no more.
            served.until("the jog ends", 90, |s| s["activity"]["doing"] == "idle" && s["axes"][0]["moving"] == false);
            drop(socket);
        }
        let there = served.position("scope.x").unwrap();
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(served.position("scope.x").unwrap(), there, "{how}: it rests");
    }
}

#[test]
fn two_pages_that_want_control_get_it_one_after_the_other() {
    let served = Served::start(&[]);
    let take = |name: &str, force: bool| served.post("/api/control", &json!({ "name": name, "force": force }));
    let ann = take("Ann", false).json()["key"].as_str().unwrap().to_owned();
    let refused = take("Bob", false);
    assert_eq!(refused.status, 409);
    assert!(refused.json()["error"].as_str().unwrap().contains("Ann has control"), "{refused:?}");
    let go = |key: &str, to: f64| {
        let headers = [("content-type", "application/json"), ("x-parfocal-key", key)];
        let body = json!({ "to_um": { "scope.y": to } }).to_string();
        send(&served.address, "POST", "/api/move", &headers, body.as_bytes())
    };
    assert_eq!(go("", 10.0).status, 409, "nobody moves without a key");
    assert_eq!(go(&ann, 8000.0).status, 200);
    served.until("it moves", 90, |s| s["axes"][1]["moving"] == true);
    // By force: what Ann began is stopped.
    let bob = take("Bob", true).json()["key"].as_str().unwrap().to_owned();
    let state = served.until("it stops", 90, |s| s["activity"]["doing"] == "idle" && s["axes"][1]["moving"] == false);
    assert!(state["axes"][1]["position_um"].as_f64().unwrap() < 7900.0);
    assert_eq!(state["operator"], "Bob");
    let refused = go(&ann, 0.0);
    assert_eq!(refused.status, 409);
    assert!(refused.json()["error"].as_str().unwrap().contains("Bob has control"));
    // Both at once, again and again: never two operators.
    std::thread::scope(|scope| {
        let keys: Vec<_> = (0..2)
            .map(|i| {
                scope.spawn(move || {
                    (0..20)
                        .map(|_| take(&format!("tab {i}"), true).json()["key"].as_str().unwrap().to_owned())
                        .collect::<Vec<_>>()
                })
            })
            .collect();
        let keys: Vec<String> = keys.into_iter().flat_map(|t| t.join().unwrap()).chain([bob]).collect();
        let allowed = keys.iter().filter(|key| {
            let headers = [("content-type", "application/json"), ("x-parfocal-key", key.as_str())];
            send(&served.address, "POST", "/api/cancel", &headers, b"{}").status == 200
        });
        assert_eq!(allowed.count(), 1);
    });
}

#[test]
fn anyone_may_stop_a_move_and_a_scan() {
    let mut served = Served::start(&[]);
    served.take();
    assert_eq!(served.post("/api/move", &json!({ "to_um": { "scope.x": 9000.0 } })).status, 200);
    served.until("it moves", 90, |s| s["axes"][0]["position_um"].as_f64().unwrap() > 100.0);
    let stop = || send(&served.address, "POST", "/api/stop", &[("content-type", "application/json")], b"{}");
    assert_eq!(stop().status, 200);
    let state = served.until("it stops", 90, |s| s["activity"]["doing"] == "idle" && s["axes"][0]["moving"] == false);
    assert!(state["axes"][0]["position_um"].as_f64().unwrap() < 8900.0);
    assert_ne!(state["axes"][0]["trust"], "lost");

    assert_eq!(served.post("/api/autofocus", &json!({ "strategy": "scan" })).status, 200);
    served.until("it scans", 90, |s| s["focus"]["samples"].as_u64() > Some(5));
    let busy = served.post("/api/move", &json!({ "to_um": { "scope.x": 0.0 } }));
    assert!(busy.status == 409 && busy.json()["error"].as_str().unwrap().contains("focusing"), "{busy:?}");
    assert_eq!(stop().status, 200);
    let state = served.until("the scan ends", 90, |s| s["activity"]["doing"] == "idle");
    assert!(state["focus"]["refused"].is_string(), "{}", state["focus"]);
    // After a stop everything works as before.
    let moved = served.post("/api/move", &json!({ "to_um": { "scope.x": 0.0, "scope.z": 5.0 }, "wait": true }));
    assert_eq!((moved.status, moved.json()["ok"].clone()), (200, json!(true)), "{moved:?}");
    assert_eq!(served.position("scope.z"), Some(5.0));
}

#[test]
fn a_browser_that_never_reads_slows_nothing() {
    let mut served = Served::start(&[]);
    served.take();
    // Two pages that take every picture they can get, and read none.
    let deaf: Vec<_> = (0..2)
        .map(|_| {
            let mut socket = live(&served);
            for _ in 0..50 {
                socket.send(Message::text("{\"type\":\"drawn\"}")).unwrap();
            }
            socket
        })
        .collect();
    let body = json!({ "range_um": [-4.0, 4.0], "strategy": "scan" });
    let begun = served.post("/api/autofocus", &body);
    assert_eq!(begun.status, 200, "{begun:?}");
    let state = served.until("the scan ends", 90, |s| s["activity"]["doing"] == "idle");
    assert!(state["focus"]["samples"].as_u64().unwrap() >= 12, "{}", state["focus"]);
    let frame = served.state()["camera"]["frame"].as_u64();
    served.until("pictures go on", 90, |s| s["camera"]["frame"].as_u64() > frame);
    drop(deaf);
}
