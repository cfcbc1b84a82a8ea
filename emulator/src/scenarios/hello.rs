//! Who are you?

use super::connect;
use crate::figures::Figures;
use crate::talk::Link;
use anyhow::ensure;
use parfocal_protocol::message::ResetCause;
use std::path::Path;

/// Hello and status over USART3.
///
/// # Errors
/// When the board says anything else than it should.
pub fn over_serial(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    over(elf, Link::Serial)
}

/// The same over USB, enumeration first.
///
/// # Errors
/// When the board says anything else than it should.
pub fn over_usb(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    over(elf, Link::Usb)
}

/// Driver enables, low is on (docs/wiring.md).
pub const ENABLES: [(char, u8); 4] = [('F', 12), ('F', 13), ('F', 14), ('F', 15)];

fn over(elf: &Path, link: Link) -> anyhow::Result<String> {
    let (mut board, mut talk) = connect(elf, link)?;
    let hello = talk.hello(&mut board)?;
    ensure!(hello.schema == parfocal_protocol::SCHEMA, "the board speaks another schema");
    ensure!(hello.reset == ResetCause::Power, "it says it was started by {:?}, not by power", hello.reset);
    ensure!(hello.axes == 4 && hello.board.as_str() == "NUCLEO-F429ZI", "it says it is {hello:?}");
    let status = talk.status(&mut board)?;
    ensure!(status.in_position && status.axes.iter().all(|a| !a.moving), "it moves without being asked: {status:?}");
    let edges: usize = board.world.axes.iter().map(|a| a.lock().expect("turns").step.len()).sum();
    ensure!(edges == 0, "{edges} STEP edges came out without being asked");
    for pin in ENABLES {
        ensure!(board.level(pin)?, "P{}{} is low: a driver was switched on without being asked", pin.0, pin.1);
    }
    board.stop()?.clean()?;
    Ok(format!("{} at revision {}, boot {:08x}", hello.board.as_str(), hello.git.as_str(), hello.boot))
}
