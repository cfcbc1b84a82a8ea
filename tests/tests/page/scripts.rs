//! The HTTP API as docs/api.md describes it.

use parfocal_tests::page::Served;
use serde_json::json;
use std::path::Path;
use std::process::Command;

/// The document.
fn document() -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/api.md")).unwrap()
}

#[test]
fn the_python_example_of_the_documentation_runs() {
    if !Command::new("python3").arg("--version").output().is_ok_and(|o| o.status.success()) {
        eprintln!("skipped: python3 is missing");
        return;
    }
    let text = document();
    let example = text.split("```python\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
    let served = Served::start(&[]);
    let example = example.replace("http://127.0.0.1:8321", &format!("http://{}", served.address));
    let output = Command::new("python3").args(["-c", &example]).output().unwrap();
    let (said, complaint) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success() && said.contains("in focus at"), "{said}{complaint}");
    assert!(served.position("scope.z").unwrap().abs() < 2.0);
}

#[test]
fn every_path_of_the_documentation_is_there_and_every_path_is_documented() {
    let text = document();
    let served = Served::start(&[]);
    let mut paths = 0;
    for line in text.lines().filter(|line| line.starts_with("| `")) {
        let call = line.trim_start_matches("| `").split('`').next().unwrap();
        let Some((method, path)) = call.split_once(' ') else { continue };
        let path = path.split('?').next().unwrap();
        let status = match method {
            "GET" => served.get(path).status,
            _ => served.post(path, &json!({ "no_such_key": 1 })).status,
        };
        assert!(status != 404 && status != 405, "{call}: {status}");
        paths += 1;
    }
    assert!(paths >= 18, "{paths}");
    assert_eq!(served.get("/api/no-such-thing").status, 404);
    assert_eq!(served.get("/api/move").status, 405);
}
