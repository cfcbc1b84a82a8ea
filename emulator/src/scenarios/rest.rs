//! Power-off and on again: what is known of the resting place.

use super::{axis_settings, connect};
use crate::Machine;
use crate::figures::Figures;
use crate::talk::{Link, Talk};
use anyhow::ensure;
use parfocal_protocol::message::{Request, ResetCause, Trust};
use parfocal_protocol::settings::AxisSettings;
use parfocal_protocol::units::{Axis, Nanometres, StepsPerMicrometre};
use std::path::Path;
use std::time::Duration;

/// The board keeps where it rests after 2 s of rest.
const KEPT: Duration = Duration::from_millis(2_500);

fn go(board: &mut Machine, talk: &mut Talk, um: [Option<i32>; 4]) -> anyhow::Result<()> {
    talk.ask(board, Request::Move { to: um.map(|um| um.map(|um| Nanometres(um * 1000))), speed: None })?;
    Ok(())
}

/// Power off and on: a new chip with the old one's flash.
fn again(elf: &Path, board: Machine) -> anyhow::Result<(Machine, Talk)> {
    let flash = board.world.flash.clone();
    board.stop()?.clean()?;
    let mut board = Machine::start_with(elf, flash)?;
    board.run_for(Duration::from_millis(20))?;
    let mut talk = Talk::new(Link::Serial, 0x7001);
    let hello = talk.hello(&mut board)?;
    ensure!(hello.reset == ResetCause::Power, "it says it was started by {:?}", hello.reset);
    let edges: usize = board.world.axes.iter().map(|a| a.lock().expect("turns").step.len()).sum();
    ensure!(edges == 0, "{edges} STEP edges came out by connecting");
    Ok((board, talk))
}

/// Parked at the driver's phase: restored. Elsewhere: restored roughly. Never set: counted only. Power gone in motion: unknown.
///
/// # Errors
/// When a position is told that is not true, or trusted more than it can be.
pub fn power_cycle(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    let (mut board, mut talk) = connect(elf, Link::Serial)?;
    let settings = AxisSettings { steps_per_um: StepsPerMicrometre(16.0), microsteps: 16, ..AxisSettings::default() };
    for axis in 0..3 {
        axis_settings(&mut board, &mut talk, axis, settings)?;
    }
    talk.ask(&mut board, Request::Save)?;
    for axis in [0, 1] {
        talk.ask(&mut board, Request::SetPosition { axis: Axis(axis), at: Nanometres(0) })?;
    }
    // 4 full steps of 16 microsteps are 4 µm: 40 µm is at the driver's phase, 41 is not.
    go(&mut board, &mut talk, [Some(40), Some(41), Some(8), None])?;
    board.run_for(KEPT)?;
    let before = talk.status(&mut board)?;
    ensure!(before.in_position, "it still moves");
    let (mut board, mut talk) = again(elf, board)?;
    let after = talk.status(&mut board)?;
    for axis in 0..3 {
        let (old, new) = (before.axes[axis], after.axes[axis]);
        ensure!(
            old.position == new.position,
            "axis {axis} was at {:?} and is told at {:?}",
            old.position,
            new.position
        );
    }
    let trust: Vec<Trust> = after.axes[..3].iter().map(|a| a.trust).collect();
    ensure!(trust == [Trust::Restored, Trust::RestoredRoughly, Trust::Unknown], "the positions are worth {trust:?}");
    // Power that goes in mid-move: what was kept before no longer holds.
    go(&mut board, &mut talk, [Some(400), None, None, None])?;
    board.run_for(Duration::from_millis(150))?;
    let (mut board, mut talk) = again(elf, board)?;
    let lost = talk.status(&mut board)?.axes[0].trust;
    ensure!(matches!(lost, Trust::Unknown | Trust::Lost), "after power went in motion the position is worth {lost:?}");
    let found = talk.ask(&mut board, Request::GetAxis { axis: Axis(1) })?;
    ensure!(
        matches!(found, parfocal_protocol::message::Response::Axis(s) if s == settings),
        "settings did not survive: {found:?}"
    );
    board.stop()?.clean()?;
    Ok("places at rest come back, worth what the driver's phase allows; one in motion does not".into())
}
