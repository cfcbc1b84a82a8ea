//! What host-in-the-loop tests share. The tests themselves are in `tests/tests`.

pub mod http;
pub mod page;
pub mod rig;
pub mod rig_file;
pub mod webdriver;

use std::path::PathBuf;
use std::process::Command;

/// The folder of real stacks and points: `PARFOCAL_DATA`, or `../shared/data` beside the project.
///
/// A test that needs it carries `#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]`.
///
/// # Panics
/// When the folder is not there: under CI that is a failure with this sentence, elsewhere such tests are ignored.
pub fn shared_data(name: &str) -> PathBuf {
    let folder = std::env::var_os("PARFOCAL_DATA")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
    let path = folder.join(name);
    assert!(path.exists(), "{} is missing: set PARFOCAL_DATA to the folder of real stacks", path.display());
    path
}

/// The command `parfocal`, as built beside these tests.
///
/// # Panics
/// When it is not built: `cargo build -p parfocal` builds it, as `cargo xtask test` does.
pub fn parfocal() -> Command {
    let tests = std::env::current_exe().expect("a test knows its own program");
    let folder = tests.parent().and_then(|deps| deps.parent()).expect("target/PROFILE/deps");
    let program = folder.join(format!("parfocal{}", std::env::consts::EXE_SUFFIX));
    assert!(program.exists(), "{} is missing: run `cargo build -p parfocal` first", program.display());
    Command::new(program)
}

/// Runs `parfocal --json ARGUMENTS` and gives its exit code and its one JSON object.
///
/// # Panics
/// When it prints anything else on stdout.
pub fn parfocal_json(arguments: &[&str]) -> (i32, serde_json::Value) {
    let output = parfocal().arg("--json").args(arguments).output().expect("parfocal starts");
    let text = String::from_utf8(output.stdout).expect("stdout is UTF-8");
    let value = serde_json::from_str(&text)
        .unwrap_or_else(|e| panic!("{e}: stdout {text:?}, stderr {:?}", String::from_utf8_lossy(&output.stderr)));
    (output.status.code().unwrap_or(-1), value)
}
