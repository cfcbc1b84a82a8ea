//! What is tried on the emulated board, and what must come of it.

mod hello;
mod motion;

use crate::Machine;
use crate::figures::Figures;
use crate::talk::{Link, Talk};
use anyhow::ensure;
use std::path::Path;
use std::time::Duration;

/// A scenario: its name, what it shows, and how.
pub struct Scenario {
    /// Its name on the command line.
    pub name: &'static str,
    /// What it shows.
    pub shows: &'static str,
    /// Plays it.
    pub play: fn(&Path, &mut Figures) -> anyhow::Result<String>,
}

/// All scenarios.
pub const ALL: &[Scenario] = &[
    Scenario { name: "serial", shows: "the board answers over USART3", play: hello::over_serial },
    Scenario { name: "usb", shows: "a computer enumerates the board and talks to its serial port", play: hello::over_usb },
    Scenario { name: "edges", shows: "edges counted, distance asked and position told are one", play: motion::edges },
];

/// Switches a board on and connects to it.
///
/// # Errors
/// When it does not answer.
pub fn connect(elf: &Path, link: Link) -> anyhow::Result<(Machine, Talk)> {
    let mut board = Machine::start(elf)?;
    if link == Link::Usb {
        board.world.usb.lock().expect("turns").plug_in();
    }
    board.run_for(Duration::from_millis(20))?;
    if link == Link::Usb {
        let usb = board.world.usb.lock().expect("turns");
        ensure!(usb.is_open(), "enumeration is stuck at {:?}", usb.transfers.front());
        ensure!(usb.answers.iter().all(Option::is_some), "the board stalled a request: {:?}", usb.answers);
    }
    let mut talk = Talk::new(link, 0xb0a7);
    talk.hello(&mut board)?;
    Ok((board, talk))
}
