//! `parfocal simulate`: the simulated rig for other programs, in real time.

use super::connection::Connection;
use super::{Output, interrupt};
use anyhow::Context;
use parfocal_simulator::model::RigModel;
use parfocal_simulator::rig::Rig;
use serialport::{SerialPort, TTYPort};
use std::io::{Read, Write};
use std::time::{Duration, Instant};

/// Offer the simulated rig's boards on pseudo-terminals, in real time
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// One pseudo-terminal a board; their names are printed, and work as --port of any program
    #[arg(long, required = true)]
    pty: bool,
    /// Only the first so many boards
    #[arg(long, default_value_t = usize::MAX, hide_default_value = true)]
    boards: usize,
}

/// How far real and simulated time may part: the boards' shortest reaction to a byte.
const TICK: Duration = Duration::from_micros(500);

impl Arguments {
    /// Runs the command until Ctrl-C.
    ///
    /// # Errors
    /// When the system gives no pseudo-terminal.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        interrupt::watch();
        let mut rig = Rig::new(RigModel::new(connection.seed));
        let (mut ports, mut names) = (Vec::new(), Vec::new());
        for _ in 0..rig.boards().min(self.boards) {
            let (mut board, far) = TTYPort::pair().context("the system gives no pseudo-terminal")?;
            board.set_timeout(Duration::ZERO)?;
            names.extend(far.name());
            // Another program opens the far end and locks it for itself: it must not be open here. While nobody has it
            // open, reading gives an error, which counts as silence.
            ports.push(board);
        }
        let text = format!("{}\n(Ctrl-C ends it)", names.join("\n"));
        out.result(&text, &serde_json::json!({ "ports": names }))?;
        std::io::stdout().flush()?;
        let began = Instant::now();
        let mut buffer = [0; 1024];
        while interrupt::keep_on() {
            for (board, port) in ports.iter_mut().enumerate() {
                if let Ok(n) = port.read(&mut buffer) {
                    rig.send(board, &buffer[..n]);
                }
            }
            let now = began.elapsed().as_micros() as u64;
            rig.advance(now);
            for (board, port) in ports.iter_mut().enumerate() {
                loop {
                    let n = rig.receive(board, &mut buffer, 0);
                    // A full terminal: nobody reads, and what is lost is asked for again.
                    if n == 0 || port.write_all(&buffer[..n]).is_err() {
                        break;
                    }
                }
            }
            std::thread::sleep(TICK);
        }
        Ok(())
    }
}
