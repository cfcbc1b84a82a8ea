//! The subcommands, one file each. A new one is a file here, a line in this list and one in [`Command`].

mod autofocus;
mod calibrate;
mod camera;
mod clicking;
mod coarse;
mod coaxial;
mod connection;
mod current;
mod declare;
mod dfu;
mod focus;
mod goto;
mod guarded;
mod hold;
mod home;
mod info;
mod interrupt;
mod jog;
mod live;
mod move_;
mod move_pulses;
mod objective;
mod paced;
mod ports;
mod remembered;
mod serve;
mod settings;
mod setup;
mod simulate;
mod simulated;
mod status;
mod stop;
mod tip;
mod unattended;
mod vibrate;
mod where_;

pub use connection::Connection;

use clap::Subcommand;

/// Everything `parfocal` can be asked to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    Setup(setup::Arguments),
    Ports(ports::Arguments),
    Info(info::Arguments),
    Status(status::Arguments),
    Move(move_::Arguments),
    Stop(stop::Arguments),
    Jog(jog::Arguments),
    Home(home::Arguments),
    Vibrate(vibrate::Arguments),
    Hold(hold::Hold),
    Resume(hold::Resume),
    Declare(declare::Arguments),
    Enable(current::Enable),
    Disable(current::Disable),
    Dfu(dfu::Arguments),
    Settings(settings::Arguments),
    Autofocus(Box<autofocus::Arguments>),
    Calibrate(Box<calibrate::Calibrate>),
    Objective(objective::Arguments),
    Goto(goto::Arguments),
    Coaxial(coaxial::Arguments),
    Where(where_::Arguments),
    Focus(focus::Focus),
    Serve(Box<serve::Arguments>),
    Simulate(simulate::Arguments),
    Tip(tip::Arguments),
}

/// Runs one command.
///
/// # Errors
/// Whatever stopped it, as one sentence for a person; the exit code is then 1.
pub fn run(command: Command, connection: &Connection, out: Output) -> anyhow::Result<()> {
    match command {
        Command::Setup(a) => a.run(connection, out),
        Command::Ports(a) => a.run(out),
        Command::Info(a) => a.run(connection, out),
        Command::Status(a) => a.run(connection, out),
        Command::Move(a) => a.run(connection, out),
        Command::Stop(a) => a.run(connection, out),
        Command::Jog(a) => a.run(connection, out),
        Command::Home(a) => a.run(connection, out),
        Command::Vibrate(a) => a.run(connection, out),
        Command::Hold(a) => a.run(connection, out),
        Command::Resume(a) => a.run(connection, out),
        Command::Declare(a) => a.run(connection, out),
        Command::Enable(a) => a.run(connection, out),
        Command::Disable(a) => a.run(connection, out),
        Command::Dfu(a) => a.run(connection, out),
        Command::Settings(a) => a.run(connection, out),
        Command::Autofocus(a) => a.run(connection, out),
        Command::Calibrate(a) => calibrate::run(*a, connection, out),
        Command::Objective(a) => a.run(connection, out),
        Command::Goto(a) => a.run(connection, out),
        Command::Coaxial(a) => a.run(connection, out),
        Command::Where(a) => a.run(connection, out),
        Command::Focus(a) => focus::run(a, out),
        Command::Serve(a) => a.run(connection, out),
        Command::Simulate(a) => a.run(connection, out),
        Command::Tip(a) => a.run(connection, out),
    }
}

/// A refusal that the command has told already, in words and as JSON: only the exit code is left to say it.
#[derive(Debug, thiserror::Error)]
#[error("refused")]
pub struct Refused;

/// How a command speaks: people's text on stderr or stdout, or one JSON object on stdout.
#[derive(Clone, Copy, Debug)]
pub struct Output {
    /// `--json`: exactly one JSON object on stdout; text and progress go to stderr.
    pub json: bool,
}

impl Output {
    /// Prints a command's result: `text` for people on stdout; with `--json` there on stderr, and `value` on stdout.
    ///
    /// # Errors
    /// When stdout cannot be written (a closed pipe is success, see `main`).
    pub fn result(&self, text: &str, value: &impl serde::Serialize) -> anyhow::Result<()> {
        use std::io::Write;
        let mut out = std::io::stdout().lock();
        if self.json {
            eprintln!("{}", text.trim_end());
            serde_json::to_writer(&mut out, value)?;
            writeln!(out)?;
        } else {
            writeln!(out, "{}", text.trim_end())?;
        }
        Ok(())
    }
}
