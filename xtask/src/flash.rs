//! `cargo xtask flash`: builds the firmware and writes it to a NUCLEO-F429ZI through its ST-LINK.

use crate::firmware;
use crate::run::{check, command, works};
use anyhow::bail;

/// Builds the firmware, writes it to the board and shows its log
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Leave once it is written, without showing the log
    #[arg(long)]
    no_log: bool,
}

/// The chip as probe-rs calls it.
const CHIP: &str = "STM32F429ZITx";

impl Arguments {
    /// Builds and writes.
    ///
    /// # Errors
    /// When the firmware does not build, probe-rs is missing, or no board answers.
    pub fn run(&self) -> anyhow::Result<()> {
        let elf = firmware::build()?;
        if !works(command("probe-rs").arg("--version")) {
            bail!("probe-rs is missing: install it with `cargo install probe-rs-tools`, then call this again");
        }
        // Settings lie in the second flash bank; only the sectors that the program takes are erased.
        let verb = if self.no_log { "download" } else { "run" };
        check(command("probe-rs").args([verb, "--chip", CHIP]).arg(&elf))?;
        if self.no_log {
            check(command("probe-rs").args(["reset", "--chip", CHIP]))?;
        }
        Ok(())
    }
}
