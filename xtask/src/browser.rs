//! The browser that the operator page is tested in: Debian's packages, installed where that is possible.

use crate::run::{check, command, works};
use std::process::Stdio;

/// Installs headless Chromium and its driver if they are missing, this is Debian, and the person may.
///
/// # Errors
/// When the installation fails. Where nothing can be installed the tests say so: they are skipped, under CI they fail.
pub fn install() -> anyhow::Result<()> {
    let there = |program: &str| works(command(program).arg("--version"));
    if there("chromium") && there("chromedriver") {
        return Ok(());
    }
    let may = command("id").arg("-u").stderr(Stdio::null()).output().is_ok_and(|o| o.stdout == b"0\n");
    if !may || !there("apt-get") {
        eprintln!("the operator page is not tried in a browser: apt-get install chromium chromium-driver");
        return Ok(());
    }
    check(command("apt-get").args(["update", "--quiet"]))?;
    let packages = ["install", "--yes", "--quiet", "--no-install-recommends", "chromium", "chromium-driver"];
    check(command("apt-get").args(packages).env("DEBIAN_FRONTEND", "noninteractive"))
}
