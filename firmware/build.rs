//! Tells the board's program which revision it was built from, and the linker where the board's memory is.

use std::path::Path;
use std::process::Command;
use std::{env, fs};

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-env=PARFOCAL_GIT={}", revision());
    // On a PC there is no memory to lay out.
    if env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        let memory = Path::new(env!("CARGO_MANIFEST_DIR")).join("../memory.x");
        let out = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
        fs::copy(&memory, Path::new(&out).join("memory.x")).expect("memory.x stands beside the workspace's Cargo.toml");
        println!("cargo::rustc-link-search={out}");
        println!("cargo::rerun-if-changed={}", memory.display());
    }
}

/// Short hash of the checked-out commit, with a `+` when files differ from it; 'unknown' without git.
fn revision() -> String {
    let git = |args: &[&str]| {
        // Asking writes nothing: a refreshed index would look like a change to the next build.
        let out = Command::new("git")
            .arg("--no-optional-locks")
            .args(args)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output()
            .ok()?;
        out.status.success().then(|| String::from_utf8_lossy(&out.stdout).trim().to_string())
    };
    for file in ["HEAD", "index"] {
        if let Some(path) = git(&["rev-parse", "--path-format=absolute", "--git-path", file]) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    let Some(hash) = git(&["rev-parse", "--short=10", "HEAD"]) else { return "unknown".into() };
    let changed = git(&["status", "--porcelain", "--untracked-files=no"]).is_some_and(|s| !s.is_empty());
    hash + if changed { "+" } else { "" }
}
