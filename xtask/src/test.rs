//! `cargo xtask test`: everything that must hold before a change is good.

use super::emulate;
use super::run::{cargo, check, works};
use clap::ValueEnum;
use std::time::Instant;

/// Run every check, or only some: format, lints, unit and integration tests, documentation, firmware, emulator
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Only these steps
    #[arg(long, value_enum, value_delimiter = ',')]
    only: Vec<Step>,
    /// Only this crate's tests, in seconds: `-p parfocal-protocol`
    #[arg(long, short, value_name = "CRATE")]
    package: Option<String>,
}

/// One part of the checks, in the order in which they run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Step {
    /// rustfmt finds nothing to change
    Format,
    /// Clippy finds nothing to say
    Lints,
    /// Tests on this computer
    Tests,
    /// Examples in the documentation, and its links
    Docs,
    /// The firmware, and the scenarios on the emulated board
    Emulator,
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// The first step that failed.
    pub fn run(self) -> anyhow::Result<()> {
        if let Some(package) = &self.package {
            // Tests of the command run the program itself; with the whole workspace it is built anyway.
            check(cargo().args(["build", "--quiet", "--package", "parfocal"]))?;
            return tests(&["--package", package]);
        }
        let mut times = Vec::new();
        for step in Step::value_variants().iter().filter(|s| self.only.is_empty() || self.only.contains(s)) {
            eprintln!("\n== {step:?}");
            let began = Instant::now();
            step.run()?;
            times.push((step, began.elapsed().as_secs()));
        }
        for (step, seconds) in times {
            eprintln!("{step:?}: {seconds} s");
        }
        Ok(())
    }
}

/// Scenarios of the emulated board that every check plays.
const EVERY_TIME: [&str; 17] = [
    "serial",
    "usb",
    "edges",
    "exactness",
    "cost",
    "telemetry",
    "scan",
    "scan-noise",
    "scan-serial",
    "trigger",
    "stop",
    "stall",
    "host-lost",
    "dfu",
    "power-cycle",
    "watchdog",
    "emergency",
];

impl Step {
    fn run(self) -> anyhow::Result<()> {
        match self {
            Self::Format => check(cargo().args(["fmt", "--all", "--check"])),
            Self::Lints => {
                check(cargo().args(["clippy", "--workspace", "--all-targets", "--quiet", "--", "-D", "warnings"]))
            }
            Self::Tests => {
                super::browser::install()?;
                tests(&["--workspace"])
            }
            Self::Docs => {
                check(cargo().args(["test", "--workspace", "--doc", "--quiet"]))?;
                check(
                    cargo()
                        .args(["doc", "--workspace", "--no-deps", "--quiet"])
                        .env("RUSTDOCFLAGS", "-D warnings -A rustdoc::private_intra_doc_links"),
                )
            }
            // The top rates take a minute more: `cargo xtask emulate` plays them with the rest.
            Self::Emulator => emulate::Arguments::of(&EVERY_TIME).run(),
        }
    }
}

/// With nextest where it is installed: it names slow tests and ends the hung ones.
fn tests(which: &[&str]) -> anyhow::Result<()> {
    if works(cargo().args(["nextest", "--version"])) {
        check(cargo().args(["nextest", "run", "--no-fail-fast"]).args(which))
    } else {
        check(cargo().args(["test", "--all-targets", "--no-fail-fast"]).args(which))
    }
}
