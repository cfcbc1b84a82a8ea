//! The subcommands, one file each. A new one is a file here, a line in this list and one in [`Command`].

pub mod focus;

use clap::Subcommand;

/// Everything `parfocal` can be asked to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    Focus(focus::Focus),
}

/// How a command speaks: people's text on stderr or stdout, or one JSON object on stdout.
#[derive(Clone, Copy, Debug)]
pub struct Output {
    /// `--json`: exactly one JSON object on stdout; text and progress go to stderr.
    pub json: bool,
}

impl Output {
    /// Prints a command's result: `text` for people, or `value` as the one JSON object.
    ///
    /// # Errors
    /// When stdout cannot be written (a closed pipe is success, see `main`).
    pub fn result(&self, text: &str, value: &impl serde::Serialize) -> anyhow::Result<()> {
        use std::io::Write;
        let mut out = std::io::stdout().lock();
        if self.json {
            serde_json::to_writer(&mut out, value)?;
            writeln!(out)?;
        } else {
            writeln!(out, "{}", text.trim_end())?;
        }
        Ok(())
    }
}

/// Runs one command.
///
/// # Errors
/// Whatever stopped it, as one sentence for a person; the exit code is then 1.
pub fn run(command: Command, out: Output) -> anyhow::Result<()> {
    match command {
        Command::Focus(focus) => focus::run(focus, out),
    }
}
