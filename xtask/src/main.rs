//! What a person would otherwise have to remember: `cargo xtask test|firmware|flash|emulate|bench`.

mod bench;
mod browser;
mod emulate;
mod firmware;
mod flash;
mod run;
mod test;

use clap::{Parser, Subcommand};

/// Builds, tests, flashes and measures Parfocal
#[derive(Debug, Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    Test(test::Arguments),
    Firmware(firmware::Arguments),
    Flash(flash::Arguments),
    Emulate(emulate::Arguments),
    Bench(bench::Arguments),
}

fn main() -> anyhow::Result<()> {
    match Arguments::parse().task {
        Task::Test(a) => a.run(),
        Task::Firmware(a) => a.run(),
        Task::Flash(a) => a.run(),
        Task::Emulate(a) => a.run(),
        Task::Bench(a) => a.run(),
    }
}
