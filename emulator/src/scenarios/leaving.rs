//! Into the chip's own bootloader on request.

use super::{axis_settings, connect, rest};
use crate::figures::Figures;
use crate::machine::BOOTLOADER;
use crate::talk::Link;
use anyhow::ensure;
use parfocal_protocol::message::{Refusal, Request, Response, Stop};
use parfocal_protocol::settings::AxisSettings;
use parfocal_protocol::units::Nanometres;
use std::path::Path;
use std::time::Duration;

/// A request for the bootloader: refused in motion; at rest the outputs go inactive, the board answers, resets, and jumps to
/// where the bootloader's vector table says, with nothing of ours running.
///
/// # Errors
/// When it does not.
pub fn bootloader(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    let (mut board, mut talk) = connect(elf, Link::Usb)?;
    axis_settings(&mut board, &mut talk, 0, AxisSettings::default())?;
    let to = [Some(Nanometres(100_000)), None, None, None];
    talk.ask(&mut board, Request::Move { to, speed: None })?;
    let moving = talk.try_ask(&mut board, Request::EnterDfu)?;
    ensure!(moving == Err(Refusal::Busy), "in motion it was answered by {moving:?}");
    talk.ask(&mut board, Request::Stop { how: Stop::Decelerate })?;
    rest(&mut board, &mut talk, Duration::from_millis(10))?;
    let edges = |board: &crate::Machine| -> usize {
        board.world.axes.iter().map(|a| a.lock().expect("turns").step.len()).sum()
    };
    let before = edges(&board);
    board.watch_instruction(BOOTLOADER);
    let answer = talk.ask(&mut board, Request::EnterDfu)?;
    ensure!(answer == Response::Done, "it was answered by {answer:?}");
    let updates = |board: &crate::Machine| -> usize {
        board.world.axes.iter().map(|a| a.lock().expect("turns").updates.len()).sum()
    };
    let stood = updates(&board);
    board.run_for(Duration::from_millis(30))?;
    ensure!(updates(&board) == stood, "the step timers still run after the answer");
    board.run_for(Duration::from_millis(120))?;
    ensure!(edges(&board) == before, "{} edges came out on the way", edges(&board) - before);
    let mut report = board.stop()?;
    // What lies at address 0 is not modelled; the jump goes to system memory's own address.
    report.unimplemented.retain(|register| register != "SYSCFG.MEMRM");
    ensure!(report.resets.len() == 1, "it was reset by {:?}", report.resets);
    ensure!(!report.hits.is_empty(), "the bootloader's entry was never reached");
    report.clean()?;
    Ok("refused in motion; at rest: timers stopped, answered, reset, and the bootloader's entry reached".into())
}
