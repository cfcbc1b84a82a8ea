//! The command `parfocal`. Exit codes: 0 done, 1 refused or failed, 2 bad usage.

mod cmd;

use clap::Parser;
use std::process::ExitCode;

/// Open control of motorised microscopes and micromanipulators.
#[derive(Debug, Parser)]
#[command(name = "parfocal", version, arg_required_else_help = true)]
struct Arguments {
    /// One JSON object on stdout; text and progress on stderr
    #[arg(long, global = true)]
    json: bool,
    #[command(flatten)]
    connection: cmd::Connection,
    #[command(subcommand)]
    command: cmd::Command,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let out = cmd::Output { json: arguments.json };
    match cmd::run(arguments.command, &arguments.connection, out) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) if error.is::<cmd::Refused>() => ExitCode::FAILURE,
        Err(error) => {
            let error = said(&error);
            eprintln!("parfocal: {error}");
            if out.json {
                println!("{}", serde_json::json!({ "error": error }));
            }
            ExitCode::FAILURE
        }
    }
}

/// An error and its causes in one line; a cause that was said already is not said again.
fn said(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}

/// A reader that went away (`parfocal … | head`) is no failure.
fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let io = cause.downcast_ref::<std::io::Error>().map(std::io::Error::kind);
        let json = cause.downcast_ref::<serde_json::Error>().and_then(serde_json::Error::io_error_kind);
        io.or(json) == Some(std::io::ErrorKind::BrokenPipe)
    })
}
