//! What is tried on the emulated board, and what must come of it.

mod beside;
mod exactness;
mod faults;
mod focus;
mod hello;
mod leaving;
mod motion;
mod noise;
mod rates;
mod rest;
mod scans;
mod trigger;

pub use scans::Times;

use crate::Machine;
use crate::figures::Figures;
use crate::talk::{Link, Talk};
use anyhow::{bail, ensure};
use parfocal_protocol::message::{Request, Status};
use parfocal_protocol::settings::AxisSettings;
use parfocal_protocol::units::Axis;
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
    Scenario {
        name: "usb",
        shows: "a computer enumerates the board and talks to its serial port",
        play: hello::over_usb,
    },
    Scenario {
        name: "edges",
        shows: "every edge on its planned tick; distance, count and position are one",
        play: motion::edges,
    },
    Scenario {
        name: "exactness",
        shows: "several axes, both edges, vibrations: within a tick of the exact formula",
        play: exactness::play,
    },
    Scenario {
        name: "scan",
        shows: "a scan over USB visits the same places as in the simulator",
        play: focus::over_usb,
    },
    Scenario { name: "scan-noise", shows: "scans on noisy curves: no decision holds the board up", play: noise::short },
    Scenario { name: "scan-long", shows: "the same over all ranges and noises of the bench", play: noise::long },
    Scenario { name: "scan-serial", shows: "the same scan over USART3", play: focus::over_serial },
    Scenario {
        name: "telemetry",
        shows: "positions are told as often as asked for, and cost no step",
        play: motion::telemetry,
    },
    Scenario { name: "trigger", shows: "every camera pulse on the tick of its step", play: trigger::pulses },
    Scenario { name: "stop", shows: "a stop in mid-move is soon, decelerated and exact", play: faults::stop },
    Scenario { name: "stall", shows: "a core that is busy for 2 ms costs no step", play: faults::stall },
    Scenario { name: "host-lost", shows: "a host that falls silent stops what it drove", play: faults::host_lost },
    Scenario {
        name: "dfu",
        shows: "outputs inactive, then the chip's own bootloader, on request",
        play: leaving::bootloader,
    },
    Scenario {
        name: "power-cycle",
        shows: "a resting place survives power-off, and is trusted as far as it can be",
        play: rest::power_cycle,
    },
    Scenario { name: "watchdog", shows: "a core that hangs is restarted; settings survive", play: faults::watchdog },
    Scenario { name: "emergency", shows: "the emergency stop is immediate and exact", play: faults::emergency },
    Scenario { name: "cost", shows: "what a step costs, and the top rate of one axis", play: rates::cost },
    Scenario { name: "rates", shows: "top step rates, both edges and several axes", play: rates::play },
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

/// Gives an axis settings.
///
/// # Errors
/// When they are refused.
pub fn axis_settings(board: &mut Machine, talk: &mut Talk, axis: usize, settings: AxisSettings) -> anyhow::Result<()> {
    talk.ask(board, Request::SetAxis { axis: Axis(axis as u8), settings }).map(|_| ())
}

/// Asks every `often` how the board is, until its motion is over.
///
/// # Errors
/// When it does not come to rest within a minute.
pub fn rest(board: &mut Machine, talk: &mut Talk, often: Duration) -> anyhow::Result<Status> {
    let until = board.now() + Duration::from_secs(60);
    while board.now() < until {
        board.run_for(often)?;
        let status = talk.status(board)?;
        if status.in_position {
            return Ok(status);
        }
    }
    bail!("it still moves after a minute")
}
