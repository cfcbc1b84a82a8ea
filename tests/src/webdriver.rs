//! Headless Chromium by the WebDriver protocol (<https://www.w3.org/TR/webdriver2/>): the few commands that the tests need.

use crate::http::send;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Why there is no browser.
pub const MISSING: &str = "chromium or chromedriver is missing: apt-get install chromium chromium-driver";

/// How long the browser may take for anything: only a failure takes it.
const PATIENCE: Duration = Duration::from_secs(60);

/// A browser with one page.
pub struct Browser {
    driver: Child,
    address: String,
    session: String,
    _profile: tempfile::TempDir,
}

fn on_path(program: &str) -> bool {
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path).any(|folder| folder.join(program).is_file())
}

impl Browser {
    /// Starts a browser; `None` where there is none, which under CI is a failure.
    ///
    /// # Panics
    /// When it is there and does not start, or is not there under CI.
    pub fn start() -> Option<Self> {
        if !on_path("chromium") || !on_path("chromedriver") {
            assert!(std::env::var_os("CI").is_none(), "{MISSING}");
            eprintln!("skipped: {MISSING}");
            return None;
        }
        let profile = tempfile::tempdir().expect("a folder for the profile");
        let port = std::net::TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr()).expect("a free port").port();
        let driver = Command::new("chromedriver")
            .arg(format!("--port={port}"))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("chromedriver starts");
        let address = format!("127.0.0.1:{port}");
        let mut browser = Self { driver, address, session: String::new(), _profile: profile };
        let end = Instant::now() + PATIENCE;
        while std::net::TcpStream::connect(&browser.address).is_err() {
            assert!(Instant::now() < end, "chromedriver does not listen");
            std::thread::sleep(Duration::from_millis(50));
        }
        let arguments = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--disable-dev-shm-usage",
            "--window-size=1440,1040",
        ];
        let mut arguments: Vec<String> = arguments.map(String::from).into();
        arguments.push(format!("--user-data-dir={}", browser._profile.path().display()));
        let wanted = json!({ "capabilities": { "alwaysMatch": {
            "browserName": "chrome", "goog:chromeOptions": { "args": arguments },
            "goog:loggingPrefs": { "browser": "ALL" },
        } } });
        let session = browser.command("POST", "/session", &wanted);
        browser.session = session["sessionId"].as_str().unwrap_or_else(|| panic!("no session: {session}")).into();
        Some(browser)
    }

    fn command(&self, method: &str, path: &str, body: &Value) -> Value {
        let body = if method == "POST" { body.to_string() } else { String::new() };
        let answer = send(&self.address, method, path, &[("content-type", "application/json")], body.as_bytes());
        let value = answer.json()["value"].clone();
        assert_eq!(answer.status, 200, "{method} {path}: {value}");
        value
    }

    fn own(&self, method: &str, path: &str, body: &Value) -> Value {
        self.command(method, &format!("/session/{}/{path}", self.session), body)
    }

    /// Goes to an address.
    pub fn open(&self, url: &str) {
        self.own("POST", "url", &json!({ "url": url }));
    }

    /// Loads the page again.
    pub fn reload(&self) {
        self.own("POST", "refresh", &json!({}));
    }

    /// Opens another tab as a person duplicates this one, what is kept for the session copied along, and looks at it. The tab before.
    ///
    /// # Panics
    /// When it does not open.
    pub fn duplicate(&self) -> String {
        let before = self.own("GET", "window", &Value::Null).as_str().unwrap_or_default().to_owned();
        self.run("window.open(location.href)");
        let end = Instant::now() + PATIENCE;
        loop {
            let all = self.own("GET", "window/handles", &Value::Null);
            if let Some(other) = all.as_array().into_iter().flatten().find(|tab| **tab != json!(before)) {
                self.look_at(other.as_str().unwrap_or_default());
                return before;
            }
            assert!(Instant::now() < end, "no other tab opens: {all}");
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// Looks at another tab.
    pub fn look_at(&self, tab: &str) {
        self.own("POST", "window", &json!({ "handle": tab }));
    }

    /// Runs a function's body in the page; what it returns, promises awaited.
    pub fn run(&self, script: &str) -> Value {
        self.own("POST", "execute/sync", &json!({ "script": script, "args": [] }))
    }

    /// Waits until a script returns true, for at most `seconds`.
    ///
    /// # Panics
    /// When it never does.
    pub fn until(&self, script: &str, seconds: u64) {
        let end = Instant::now() + Duration::from_secs(seconds);
        while self.run(script) != json!(true) {
            assert!(
                Instant::now() < end,
                "not in {seconds} s: {script}; the page says {}; {}",
                self.text("body"),
                self.log()
            );
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// The visible text of the first element that a selector finds.
    pub fn text(&self, selector: &str) -> String {
        let script = format!("return document.querySelector({})?.innerText ?? ''", json!(selector));
        self.run(&script).as_str().unwrap_or_default().into()
    }

    /// The place of an element's middle in the window, px.
    ///
    /// The page draws what the server tells a moment after the server knows it: this waits until the element is there,
    /// can be used and stays where it is, as a person's eye does.
    ///
    /// # Panics
    /// When that does not come about in a minute.
    pub fn middle(&self, selector: &str) -> (f64, f64) {
        let script = format!(
            "const e = document.querySelector({}); if (!e || e.disabled) return null; e.scrollIntoView({{ block: 'nearest' }});
             const b = e.getBoundingClientRect(); return b.width > 0 ? [b.x + b.width / 2, b.y + b.height / 2] : null",
            json!(selector)
        );
        let end = Instant::now() + PATIENCE;
        let mut before = Value::Null;
        loop {
            let at = self.run(&script);
            if let (Some(x), Some(y)) = (at[0].as_f64(), at[1].as_f64())
                && at == before
            {
                return (x, y);
            }
            assert!(Instant::now() < end, "{selector} is not there to be used; the page says {}", self.text("body"));
            before = at;
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// Mouse: presses at a place, moves over others, releases at the last one.
    pub fn drag(&self, places: &[(f64, f64)]) {
        let mut actions = Vec::new();
        for (i, (x, y)) in places.iter().enumerate() {
            actions
                .push(json!({ "type": "pointerMove", "duration": 20, "x": x.round() as i64, "y": y.round() as i64 }));
            if i == 0 {
                actions.push(json!({ "type": "pointerDown", "button": 0 }));
            }
        }
        actions.push(json!({ "type": "pointerUp", "button": 0 }));
        self.pointer(&actions);
    }

    /// Clicks a place.
    pub fn click_at(&self, place: (f64, f64)) {
        self.drag(&[place]);
    }

    /// Clicks an element.
    pub fn click(&self, selector: &str) {
        self.click_at(self.middle(selector));
    }

    /// Presses the mouse on an element and keeps it down.
    pub fn press(&self, selector: &str) {
        let (x, y) = self.middle(selector);
        self.pointer(&[
            json!({ "type": "pointerMove", "duration": 0, "x": x.round() as i64, "y": y.round() as i64 }),
            json!({ "type": "pointerDown", "button": 0 }),
        ]);
    }

    /// Lets the mouse go.
    pub fn release(&self) {
        self.pointer(&[json!({ "type": "pointerUp", "button": 0 })]);
    }

    fn pointer(&self, actions: &[Value]) {
        let mouse =
            json!({ "type": "pointer", "id": "mouse", "parameters": { "pointerType": "mouse" }, "actions": actions });
        self.own("POST", "actions", &json!({ "actions": [mouse] }));
    }

    /// Presses and releases a key, given as WebDriver writes it (`" "`, `"f"`).
    pub fn key(&self, key: &str) {
        let actions = [json!({ "type": "keyDown", "value": key }), json!({ "type": "keyUp", "value": key })];
        self.keys(&actions);
    }

    /// Presses a key and keeps it down, or lets it go.
    pub fn hold_key(&self, key: &str, down: bool) {
        self.keys(&[json!({ "type": if down { "keyDown" } else { "keyUp" }, "value": key })]);
    }

    fn keys(&self, actions: &[Value]) {
        self.own("POST", "actions", &json!({ "actions": [{ "type": "key", "id": "keyboard", "actions": actions }] }));
    }

    /// What the page wrote to its console.
    pub fn log(&self) -> Value {
        self.own("POST", "se/log", &json!({ "type": "browser" }))
    }

    /// Keeps a picture of the page in `target/page/NAME.png`.
    ///
    /// # Panics
    /// When it cannot be written.
    pub fn screenshot(&self, name: &str) -> PathBuf {
        let picture = self.own("GET", "screenshot", &Value::Null);
        let bytes = base64(picture.as_str().expect("a picture"));
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/page");
        std::fs::create_dir_all(&folder).expect("target/ can be written");
        let path = folder.join(format!("{name}.png"));
        std::fs::write(&path, bytes).expect("target/ can be written");
        path
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        if !self.session.is_empty() {
            let path = format!("/session/{}", self.session);
            let _ = std::panic::catch_unwind(|| send(&self.address, "DELETE", &path, &[], b""));
        }
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}

/// RFC 4648, section 4.
fn base64(text: &str) -> Vec<u8> {
    let value = |c: u8| match c {
        b'A'..=b'Z' => Some(c - b'A'),
        b'a'..=b'z' => Some(c - b'a' + 26),
        b'0'..=b'9' => Some(c - b'0' + 52),
        b'+' => Some(62),
        b'/' => Some(63),
        _ => None,
    };
    let digits: Vec<u8> = text.bytes().filter_map(value).collect();
    let mut bytes = Vec::with_capacity(digits.len() / 4 * 3);
    for four in digits.chunks(4) {
        let word = four.iter().enumerate().fold(0u32, |word, (i, d)| word | u32::from(*d) << (18 - 6 * i));
        bytes.extend(&word.to_be_bytes()[1..four.len().max(1)]);
    }
    bytes
}
