//! What a person would otherwise have to remember: `cargo xtask test|bench`.

mod bench;
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
    Bench(bench::Arguments),
}

fn main() -> anyhow::Result<()> {
    match Arguments::parse().task {
        Task::Test(a) => a.run(),
        Task::Bench(a) => a.run(),
    }
}
