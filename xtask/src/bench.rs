//! `cargo xtask bench NAME …`: builds the benches optimised and runs one.

use super::run::{cargo, check};

/// Run a bench: `cargo xtask bench autofocus --help`, `… ransac --help`, `… tips --help`
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The bench and its arguments
    #[arg(required = true, trailing_var_arg = true, allow_hyphen_values = true, value_name = "NAME …")]
    bench: Vec<String>,
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When it does not build, or the bench fails.
    pub fn run(self) -> anyhow::Result<()> {
        // Paths are meant from where the person is.
        let here = std::env::current_dir()?;
        if self.bench.first().is_some_and(|name| name == "page") {
            // This one measures the program itself.
            check(cargo().args(["build", "--quiet", "--release", "--package", "parfocal"]))?;
        }
        check(
            cargo()
                .args(["run", "--quiet", "--release", "--package", "parfocal-benches", "--manifest-path"])
                .arg(super::run::root().join("Cargo.toml"))
                .arg("--")
                .args(&self.bench)
                .current_dir(here),
        )
    }
}
