//! The benches' own program; `cargo xtask bench NAME …` builds it optimised and runs it.
//! One file a bench.

mod autofocus;
mod page;
mod ransac;
mod tips;

use clap::{Parser, Subcommand};

/// Runs one bench and writes results that can be scored.
#[derive(Debug, Parser)]
struct Arguments {
    #[command(subcommand)]
    bench: Bench,
}

/// The benches, one file each.
#[derive(Debug, Subcommand)]
enum Bench {
    /// Scans for focus on generated curves.
    Autofocus(autofocus::Arguments),
    /// Pictures for the operator page while a scan runs
    Page(page::Arguments),
    /// Robust registration of points of which some are wrong
    Ransac(ransac::Arguments),
    /// Tips of micropipettes in random scenes
    Tips(tips::Arguments),
}

fn main() -> anyhow::Result<()> {
    match Arguments::parse().bench {
        Bench::Autofocus(arguments) => autofocus::run(&arguments),
        Bench::Page(arguments) => page::run(&arguments),
        Bench::Ransac(arguments) => ransac::run(&arguments),
        Bench::Tips(arguments) => tips::run(&arguments),
    }
}
