//! `cargo xtask emulate`: plays the firmware, exactly as it is flashed, on an emulated STM32F429.

use crate::firmware;
use crate::run::{check, command};
use std::ffi::OsString;
use std::process::Command;

/// Runs the flashed firmware on an emulated board: conversations, moves, faults, figures
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Print the figures as one JSON object on stdout
    #[arg(long)]
    json: bool,
    /// Scenarios to run, by name; all of them if none is named. `list` names them
    scenarios: Vec<String>,
}

impl Arguments {
    /// Only these scenarios.
    pub fn of(scenarios: &[&str]) -> Self {
        Self { json: false, scenarios: scenarios.iter().map(ToString::to_string).collect() }
    }

    /// Builds the firmware and the emulator, and runs the scenarios.
    ///
    /// # Errors
    /// When something does not build or a scenario fails.
    pub fn run(&self) -> anyhow::Result<()> {
        let elf = firmware::build()?;
        let size = firmware::size(&elf)?;
        // Nothing installs a toolchain by itself: the one that emulator/rust-toolchain.toml names.
        // What rustup says is for people: stdout is the figures'.
        check(in_emulator("rustup").args(["toolchain", "install"]).stdout(std::io::stderr()))?;
        let mut emulator = in_emulator("cargo");
        emulator.args(["run", "--quiet", "--"]).arg(&elf);
        emulator.args(["--flash-bytes", &size.flash_bytes.to_string(), "--ram-bytes", &size.ram_bytes.to_string()]);
        emulator.args(self.json.then(|| OsString::from("--json")));
        check(emulator.args(&self.scenarios))
    }
}

/// A program in the emulator's workspace, which has a toolchain of its own: what cargo was told about ours must not reach it.
fn in_emulator(program: &str) -> Command {
    let mut command = command(program);
    command.current_dir(crate::run::root().join("emulator"));
    for name in ["RUSTUP_TOOLCHAIN", "CARGO", "RUSTC", "RUSTFLAGS", "CARGO_TARGET_DIR"] {
        command.env_remove(name);
    }
    command
}
