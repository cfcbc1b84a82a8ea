//! What must not happen when something goes wrong: a wrong step, or a wrong word about it.

use super::hello::ENABLES;
use super::{axis_settings, connect, rest};
use crate::Machine;
use crate::figures::Figures;
use crate::talk::{Link, Talk};
use anyhow::{Context, ensure};
use parfocal_protocol::message::{Request, ResetCause, Stop, StopCause, Trust};
use parfocal_protocol::settings::{AxisSettings, BoardSettings};
use parfocal_protocol::units::{Axis, Milliseconds, Nanometres, StepsPerMicrometre};
use std::path::Path;
use std::time::Duration;

/// The emergency-stop input (docs/wiring.md).
const EMERGENCY: (char, u8) = ('G', 9);

fn ms(n: u64) -> Duration {
    Duration::from_millis(n)
}

fn go(board: &mut Machine, talk: &mut Talk, um: i32) -> anyhow::Result<()> {
    let to = [Some(Nanometres(um * 1000)), None, None, None];
    talk.ask(board, Request::Move { to, speed: None }).map(|_| ())
}

fn edges(board: &Machine) -> usize {
    board.world.axes[0].lock().expect("turns").step.len()
}

fn counted(board: &Machine) -> i64 {
    board.world.axes[0].lock().expect("turns").position()
}

/// Stop in mid-move: decelerated, soon, and the position told is what came out.
///
/// # Errors
/// When it is not.
pub fn stop(elf: &Path, figures: &mut Figures) -> anyhow::Result<String> {
    let mut worst = 0.0f64;
    for link in [Link::Usb, Link::Serial] {
        let (mut board, mut talk) = connect(elf, link)?;
        go(&mut board, &mut talk, 900)?;
        board.run_for(ms(250))?;
        let asked = {
            let trace = board.world.axes[0].lock().expect("turns");
            trace.tick(rigless::time::VirtualNanos(board.now().as_nanos() as u64))
        };
        talk.ask(&mut board, Request::Stop { how: Stop::Decelerate })?;
        let status = rest(&mut board, &mut talk, ms(10))?;
        let on: Vec<bool> = ENABLES.iter().map(|pin| Ok(!board.level(*pin)?)).collect::<anyhow::Result<_>>()?;
        ensure!(on == [true, false, false, false], "one axis moved, and the drivers' enables are {on:?}");
        let trace = board.world.axes[0].lock().expect("turns");
        let rises: Vec<u64> = trace.rises().collect();
        let cruise =
            rises.windows(2).filter(|w| w[1] <= asked).map(|w| w[1] - w[0]).min().context("it did not move")?;
        let slower =
            rises.windows(2).find(|w| w[0] > asked && w[1] - w[0] > cruise + 1).context("it did not slow down")?;
        let latency = (slower[0] - asked) as f64 / 84_000.0;
        worst = worst.max(latency);
        let last = rises.windows(2).last().map_or(0, |w| w[1] - w[0]);
        ensure!(last > 3 * cruise, "it stopped abruptly: the last interval was {last} ticks, in cruise {cruise}");
        ensure!(
            trace.position() == i64::from(status.axes[0].steps.0),
            "{} steps came out, {} are told",
            trace.position(),
            status.axes[0].steps.0
        );
        drop(trace);
        board.stop()?.clean()?;
    }
    ensure!(worst <= 4.0, "the first slower step came {worst:.2} ms after the request");
    figures.stop_latency_ms = Some((worst * 1000.0).round() / 1000.0);
    Ok(format!("first slower step {worst:.2} ms after the request, transport included"))
}

/// The core busy with other things for 2 ms in mid-move: perhaps a gap, never a wrong step.
///
/// # Errors
/// When a step is lost or too many.
pub fn stall(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    let (mut board, mut talk) = connect(elf, Link::Usb)?;
    // Fast enough that the ring holds less than 2 ms.
    let fast = AxisSettings {
        steps_per_um: StepsPerMicrometre(400.0),
        acceleration: parfocal_protocol::units::MicrometresPerSecond2(20_000.0),
        driver: parfocal_protocol::settings::Driver::Tmc2209,
        ..AxisSettings::default()
    };
    axis_settings(&mut board, &mut talk, 0, fast)?;
    go(&mut board, &mut talk, 150)?;
    let mut said = 0;
    for _ in 0..3 {
        board.run_for(ms(40))?;
        board.hold(true);
        board.run_for(ms(2))?;
        board.hold(false);
        said += 1;
    }
    let status = rest(&mut board, &mut talk, ms(10))?;
    let (counted, told) = (counted(&board), status.axes[0].steps.0);
    ensure!(counted == 60_000 && told == 60_000, "{counted} steps came out and {told} are told, instead of 60000");
    ensure!(status.stopped.is_none(), "it was stopped: {:?}", status.stopped);
    let longest = {
        let trace = board.world.axes[0].lock().expect("turns");
        let rises: Vec<u64> = trace.rises().collect();
        // Gaps at full speed only: the middle of the move.
        rises[15_000..45_000].windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0)
    };
    board.stop()?.clean()?;
    Ok(format!("{said} stalls of 2 ms, no step lost; longest silence {:.2} ms", longest as f64 / 84_000.0))
}

/// A host that drives and then says nothing for longer than its timeout: decelerated stop, position kept, told at the next hello,
/// over the same link or the other one. A host that keeps talking is not lost.
///
/// # Errors
/// When it goes on, stops abruptly, or is not told.
pub fn host_lost(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    let (mut board, mut talk) = connect(elf, Link::Usb)?;
    let settings = BoardSettings { host_timeout: Milliseconds(200), ..BoardSettings::default() };
    talk.ask(&mut board, Request::SetBoard { settings })?;
    go(&mut board, &mut talk, 900)?;
    // Kept alive for longer than the timeout.
    for _ in 0..3 {
        board.run_for(ms(100))?;
        let status = talk.status(&mut board)?;
        ensure!(status.stopped.is_none(), "a host that talks was taken for lost: {:?}", status.stopped);
    }
    let heard = board.now();
    board.run_for(ms(600))?;
    let (rises, told) = {
        let trace = board.world.axes[0].lock().expect("turns");
        (trace.rises().collect::<Vec<u64>>(), trace.position())
    };
    let last = rises.last().copied().context("it never moved")?;
    let silent = {
        let trace = board.world.axes[0].lock().expect("turns");
        (last.saturating_sub(trace.tick(rigless::time::VirtualNanos(heard.as_nanos() as u64)))) as f64 / 84_000.0
    };
    let (ending, cruise) = (last - rises[rises.len() - 2], rises[1000] - rises[999]);
    ensure!(silent > 200.0 && silent < 450.0, "its last step came {silent:.0} ms after the host was heard last");
    ensure!(ending > 3 * cruise, "it stopped abruptly: the last interval was {ending} ticks, in cruise {cruise}");
    for link in [Link::Serial, Link::Usb] {
        let mut next = Talk::new(link, 0x3000 + link as u32);
        let hello = next.hello(&mut board)?;
        ensure!(hello.last_stop == Some(StopCause::HostLost), "over {link:?} it says {:?}", hello.last_stop);
        let status = next.status(&mut board)?;
        ensure!(
            i64::from(status.axes[0].steps.0) == told,
            "{told} steps came out, {:?} are told",
            status.axes[0].steps
        );
        ensure!(status.axes[0].trust != Trust::Lost, "the position counts as lost");
    }
    board.stop()?.clean()?;
    Ok(format!(
        "last step {silent:.0} ms after the last request with a timeout of 200 ms, decelerated, counted and told"
    ))
}

/// A part of the program hangs and no longer checks in: the watchdog restarts the board in mid-move, no edge comes after, the next
/// hello says why, the place is not trusted, and settings survive. Then the whole core stands still for 12 ms in mid-move: pulses
/// end by themselves, the motion is stopped and told. Then it stands still for good: the watchdog restarts that one too.
///
/// # Errors
/// When it does not.
pub fn watchdog(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    let (mut board, mut talk) = connect(elf, Link::Serial)?;
    let kept = AxisSettings { steps_per_um: StepsPerMicrometre(12.5), ..AxisSettings::default() };
    axis_settings(&mut board, &mut talk, 2, kept)?;
    talk.ask(&mut board, Request::Save)?;
    board.run_for(ms(30))?;
    go(&mut board, &mut talk, 900)?;
    board.run_for(ms(60))?;
    // Wiping out what the parts have said is as good as the silence of one.
    let checked_in = board.program.address("parfocal_firmware::board::watchdog::SEEN")?;
    let (begin, before) = (board.now(), edges(&board));
    while board.resets().is_empty() {
        ensure!(board.now() < begin + ms(50), "the watchdog has not bitten within 50 ms");
        board.poke(checked_in, 0);
        board.run_for(ms(1))?;
    }
    let moved = board.world.axes[0].lock().expect("turns").until_reset.map_or(0, |n| n.saturating_sub(before));
    ensure!(moved > 20, "it was not moving when the watchdog bit: {moved} edges while a part was silent");
    let bitten = bitten(&mut board, 1)? - begin;
    let mut talk = told_by_the_watchdog(&mut board, kept)?;
    let silent = stands_still(&mut board, &mut talk)?;

    board.world.axes.iter().for_each(|axis| axis.lock().expect("turns").clear_edges());
    go(&mut board, &mut talk, 900)?;
    board.run_for(ms(60))?;
    let begin = board.now();
    board.hold(true);
    while board.resets().len() == 1 {
        ensure!(board.now() < begin + ms(50), "the watchdog has not restarted a core that stands still within 50 ms");
        board.run_for(ms(1))?;
    }
    board.hold(false);
    let stood = self::bitten(&mut board, 2)? - begin;
    told_by_the_watchdog(&mut board, kept)?;

    let report = board.stop()?;
    ensure!(report.resets.len() == 2, "it was reset {} times", report.resets.len());
    report.clean()?;
    Ok(format!(
        "restarted {:.0} ms after a part fell silent and {:.0} ms after the core stood still for good, told, settings kept; \
         last edge {silent:.2} ms after the core stood still",
        bitten.as_secs_f64() * 1e3,
        stood.as_secs_f64() * 1e3
    ))
}

/// After the watchdog's `n`th bite: it bit once, outputs are inactive and stay so. When that was.
fn bitten(board: &mut Machine, n: usize) -> anyhow::Result<Duration> {
    board.run_for(ms(40))?;
    ensure!(board.resets().len() == n, "instead of {n} times it was reset by {:?}", board.resets());
    let reset = board.resets()[n - 1];
    ensure!(reset.cause == rigless::device::ResetCause::Model("IWDG"), "it was reset by {:?}", reset.cause);
    for (i, axis) in board.world.axes.iter().enumerate() {
        let trace = axis.lock().expect("turns");
        let after = trace.step.len() - trace.until_reset.context("a reset lets go of the outputs")?;
        ensure!(after == 0, "{after} edges came out of axis {i} after the restart");
    }
    for pin in ENABLES {
        ensure!(board.level(pin)?, "P{}{} is low: a driver was switched on by the restart", pin.0, pin.1);
    }
    Ok(Duration::from_nanos(reset.at.0))
}

/// The next hello tells of the watchdog, the settings of axis 2 are as saved, and the place is not trusted.
fn told_by_the_watchdog(board: &mut Machine, kept: AxisSettings) -> anyhow::Result<Talk> {
    let mut talk = Talk::new(Link::Serial, 0x2222 + board.resets().len() as u32);
    let hello = talk.hello(board)?;
    ensure!(hello.reset == ResetCause::Watchdog, "the hello says that {:?} started it", hello.reset);
    let found = talk.ask(board, Request::GetAxis { axis: Axis(2) })?;
    ensure!(
        matches!(found, parfocal_protocol::message::Response::Axis(s) if s == kept),
        "settings saved before did not survive: {found:?}"
    );
    let trust = talk.status(board)?.axes[0].trust;
    ensure!(trust == Trust::Unknown, "after a reset in motion the position is worth {trust:?}");
    Ok(talk)
}

/// The core stands still in mid-move for longer than its pulses last, and shorter than the watchdog's time: when the last edge
/// came, ms.
fn stands_still(board: &mut Machine, talk: &mut Talk) -> anyhow::Result<f64> {
    for axis in &board.world.axes {
        axis.lock().expect("turns").clear_edges();
    }
    go(board, talk, 900)?;
    board.run_for(ms(60))?;
    let begin = board.now();
    board.hold(true);
    board.run_for(ms(12))?;
    board.hold(false);
    let (last, steps) = {
        let trace = board.world.axes[0].lock().expect("turns");
        let began = trace.tick(rigless::time::VirtualNanos(begin.as_nanos() as u64));
        (trace.step.last().map_or(0, |e| e.tick).saturating_sub(began), trace.step.len())
    };
    let silent = last as f64 / 84_000.0;
    ensure!(steps > 100 && silent < 2.6, "the last edge came {silent:.2} ms after the core stood still");
    board.run_for(ms(60))?;
    ensure!(edges(board) == steps, "{} edges came out after it went on", edges(board) - steps);
    let status = talk.status(board)?;
    let (counted, told) = (counted(board), status.axes[0].steps.0);
    ensure!(counted == i64::from(told), "{counted} steps came out, {told} are told");
    ensure!(
        matches!(status.stopped, Some(StopCause::Underrun { axis: Axis(0) })),
        "the stop is told as {:?}",
        status.stopped
    );
    Ok(silent)
}

/// The emergency-stop input pressed in mid-move: no step from then on, position counted and flagged.
///
/// # Errors
/// When it is not so.
pub fn emergency(elf: &Path, _: &mut Figures) -> anyhow::Result<String> {
    let (mut board, mut talk) = connect(elf, Link::Usb)?;
    board.drive(EMERGENCY, false);
    let settings = BoardSettings { has_emergency_stop: true, ..BoardSettings::default() };
    talk.ask(&mut board, Request::SetBoard { settings })?;
    board.run_for(ms(20))?;
    go(&mut board, &mut talk, 900)?;
    board.run_for(ms(250))?;
    board.drive(EMERGENCY, true);
    let pressed = board.now();
    board.run_for(ms(12))?;
    let (before, last) = {
        let trace = board.world.axes[0].lock().expect("turns");
        (trace.step.len(), trace.step.last().map_or(0, |e| e.tick))
    };
    let late = {
        let trace = board.world.axes[0].lock().expect("turns");
        last.saturating_sub(trace.tick(rigless::time::VirtualNanos(pressed.as_nanos() as u64)))
    };
    board.run_for(ms(100))?;
    let after = edges(&board) - before;
    ensure!(after == 0, "{after} edges came out after the emergency stop");
    let status = talk.status(&mut board)?;
    let (counted, told) = (counted(&board), status.axes[0].steps.0);
    ensure!(status.emergency, "the status does not say 'emergency'");
    ensure!(counted == i64::from(told), "{counted} steps came out, {told} are told");
    ensure!(status.axes[0].trust == Trust::Lost, "the position is flagged {:?}", status.axes[0].trust);
    board.stop()?.clean()?;
    Ok(format!("last edge {:.2} ms after the button, position exact and flagged", late as f64 / 84_000.0))
}
