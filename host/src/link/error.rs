//! What can go wrong between host and board, in words that say what to do.

use super::explain::Explained;
use parfocal_protocol::message::{Refusal, StopCause};
use thiserror::Error;

/// Why a request brought nothing back.
#[derive(Debug, Error)]
pub enum LinkError {
    /// The port could not be opened or used.
    #[error("{0}")]
    Port(std::io::Error),
    /// Nothing answered.
    #[error("nothing on {port} answers as a Parfocal board: is it the right port, powered and flashed?")]
    NoAnswer {
        /// The port.
        port: String,
    },
    /// A board answered before, and now does not.
    #[error(
        "the board on {port} stopped answering; it stops its axes by itself. Check cable and power, then try again"
    )]
    Silent {
        /// The port.
        port: String,
    },
    /// The cable was pulled, and not plugged in again in time.
    #[error("the board on {port} was unplugged; it stops its axes by itself. Plug it in and try again")]
    Unplugged {
        /// The port.
        port: String,
    },
    /// The board speaks a newer protocol.
    #[error("the board on {port} speaks protocol {board}, this program speaks {host}: update this program")]
    BoardNewer {
        /// The port.
        port: String,
        /// The board's version.
        board: u8,
        /// This program's version.
        host: u8,
    },
    /// The board speaks an older protocol.
    #[error(
        "the board on {port} speaks protocol {board}, this program speaks {host}: flash the board with this program's firmware (`cargo xtask flash`)"
    )]
    BoardOlder {
        /// The port.
        port: String,
        /// The board's version.
        board: u8,
        /// This program's version.
        host: u8,
    },
    /// Same protocol version, other messages: two development builds.
    #[error(
        "the board on {port} was built from other message definitions (firmware {firmware}, git {git}): flash it with this program's firmware (`cargo xtask flash`)"
    )]
    OtherSchema {
        /// The port.
        port: String,
        /// The board's firmware version.
        firmware: String,
        /// Its git revision.
        git: String,
    },
    /// The board restarted while something was under way; the request may or may not have been carried out before.
    #[error(
        "the board on {port} restarted ({cause}) in the middle of a request: look where its axes are before you go on"
    )]
    Restarted {
        /// The port.
        port: String,
        /// Why it restarted.
        cause: &'static str,
    },
    /// Another program has control of the board.
    #[error("another program controls the board on {port}: close it, or take control with --take-control")]
    NotInControl {
        /// The port.
        port: String,
    },
    /// The board said no.
    #[error("{}", Explained(.0))]
    Refused(Refusal),
    /// A motion ended before its end.
    #[error("the motion stopped early: {}", Explained(.0))]
    Stopped(StopCause),
    /// The board answered a question with the answer to another one.
    #[error("the board on {port} answered out of turn: update this program and the board to the same version")]
    OutOfTurn {
        /// The port.
        port: String,
    },
}
