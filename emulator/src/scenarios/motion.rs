//! Moves: the edges that come out are the distance that was asked for, and the position that is told.

use super::connect;
use crate::figures::Figures;
use crate::talk::Link;
use anyhow::ensure;
use parfocal_protocol::message::Request;
use parfocal_protocol::units::{Nanometres, StepsPerMicrometre};
use std::path::Path;
use std::time::Duration;

/// Steps in a µm of a board with default settings.
const SCALE: StepsPerMicrometre = StepsPerMicrometre(10.0);

/// One axis there and back, then all four at once.
///
/// # Errors
/// When edges and distance differ.
pub fn edges(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    let (mut board, mut talk) = connect(elf, Link::Usb)?;
    let mut moved = 0;
    let um = |x: i32| Some(Nanometres(x * 1000));
    for to in [[um(150), None, None, None], [um(-60), None, None, None], [um(20), um(-35), um(90), um(55)]] {
        talk.ask(&mut board, Request::Move { to, speed: None })?;
        board.run_for(Duration::from_millis(1200))?;
        let status = talk.status(&mut board)?;
        for (axis, target) in to.iter().enumerate() {
            let Some(target) = target else { continue };
            let trace = board.world.axes[axis].lock().expect("turns");
            let (told, counted) = (status.axes[axis].steps.0, trace.position());
            ensure!(counted == i64::from(told), "axis {axis} tells {told} steps, {counted} came out");
            ensure!(told == SCALE.steps(*target).0, "axis {axis} stands at {told} steps instead of {target:?}");
            moved += 1;
        }
    }
    let steps: usize = board.world.axes.iter().map(|a| a.lock().expect("turns").rises().count()).sum();
    board.stop()?.clean()?;
    Ok(format!("{moved} moves, {steps} steps, every one counted and told"))
}
