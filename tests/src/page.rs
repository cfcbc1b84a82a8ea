//! `parfocal serve` on the simulated rig, for tests: started on a free port, ended with the test.

use crate::http::{Response, send};
use crate::parfocal;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// A page that is being served.
pub struct Served {
    child: Child,
    complaints: Arc<Mutex<String>>,
    /// `host:port`.
    pub address: String,
    /// The operator's key, once taken.
    pub key: String,
}

impl Served {
    /// Starts `parfocal serve` with further arguments.
    ///
    /// # Panics
    /// When it does not come up.
    pub fn start(arguments: &[&str]) -> Self {
        Self::start_program(parfocal(), arguments)
    }

    /// Starts another build of `parfocal`.
    ///
    /// # Panics
    /// When it does not come up.
    pub fn start_program(mut program: std::process::Command, arguments: &[&str]) -> Self {
        let mut child = program
            .args(["--json", "serve", "--listen", "127.0.0.1:0"])
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("parfocal starts");
        let complaints = Arc::<Mutex<String>>::default();
        let (own, mut stderr) = (complaints.clone(), child.stderr.take().expect("piped"));
        std::thread::spawn(move || {
            let mut buffer = [0; 1024];
            while let Ok(n) = stderr.read(&mut buffer) {
                if n == 0 {
                    break;
                }
                own.lock().expect("whole").push_str(&String::from_utf8_lossy(&buffer[..n]));
            }
        });
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("piped")).read_line(&mut line).expect("a line");
        let said: Value = serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line:?} {complaints:?}"));
        let address = said["address"].as_str().expect("an address");
        let address = address.trim_start_matches("http://").split('/').next().unwrap_or_default().to_owned();
        Self { child, complaints, address, key: String::new() }
    }

    /// What it wrote to its standard error.
    ///
    /// # Panics
    /// Never while the reading thread lives.
    pub fn complaints(&self) -> String {
        self.complaints.lock().expect("whole").clone()
    }

    /// Whether it still runs.
    pub fn runs(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// `GET`.
    pub fn get(&self, path: &str) -> Response {
        send(&self.address, "GET", path, &[], b"")
    }

    /// The state.
    pub fn state(&self) -> Value {
        self.get("/api/state").json()
    }

    /// `POST` of JSON with the operator's key.
    pub fn post(&self, path: &str, body: &Value) -> Response {
        let headers = [("content-type", "application/json"), ("x-parfocal-key", self.key.as_str())];
        send(&self.address, "POST", path, &headers, body.to_string().as_bytes())
    }

    /// Takes control.
    ///
    /// # Panics
    /// When it is refused.
    pub fn take(&mut self) {
        let answer = self.post("/api/control", &json!({ "name": "a test", "force": true }));
        assert_eq!(answer.status, 200, "{answer:?}");
        self.key = answer.json()["key"].as_str().expect("a key").to_owned();
    }

    /// An axis' position, µm; waits until its board was heard.
    pub fn position(&self, axis: &str) -> Option<f64> {
        let place =
            |state: &Value| state["axes"].as_array()?.iter().find(|a| a["name"] == axis)?["position_um"].as_f64();
        place(&self.until("the board is heard", 30, |state| place(state).is_some()))
    }

    /// Waits until the state is as wanted, for at most `seconds`.
    ///
    /// # Panics
    /// When it never is.
    pub fn until(&self, what: &str, seconds: u64, mut wanted: impl FnMut(&Value) -> bool) -> Value {
        let end = Instant::now() + Duration::from_secs(seconds);
        loop {
            let state = self.state();
            if wanted(&state) {
                return state;
            }
            assert!(Instant::now() < end, "{what}: not in {seconds} s; the state is {state}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        // Ctrl-C first: it ends the cameras that it started as well.
        let pid = self.child.id().to_string();
        let asked = std::process::Command::new("kill").args(["-INT", &pid]).stderr(Stdio::null()).status();
        let end = Instant::now() + Duration::from_secs(3);
        while asked.as_ref().is_ok_and(|s| s.success()) && self.runs() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(10));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
