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
    #[command(flatten)]
    connection: Connection,
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
    pub fn run(self, out: Output) -> anyhow::Result<()> {
        interrupt::watch();
        let mut rig = Rig::new(RigModel::new(self.connection.seed));
        let mut ports = Vec::new();
        for _ in 0..rig.boards().min(self.boards) {
            let (mut board, mut program) = TTYPort::pair().context("the system gives no pseudo-terminal")?;
            board.set_timeout(Duration::ZERO)?;
            // Another program opens the far end; held open here so that it survives a program's going and coming.
            program.set_exclusive(false)?;
            ports.push((board, program));
        }
        let names: Vec<String> = ports.iter().filter_map(|(_, far)| far.name()).collect();
        let text = format!("{}\n(Ctrl-C ends it)", names.join("\n"));
        out.result(&text, &serde_json::json!({ "ports": names }))?;
        std::io::stdout().flush()?;
        let began = Instant::now();
        let mut buffer = [0; 1024];
        while interrupt::keep_on() {
            for (board, (port, _)) in ports.iter_mut().enumerate() {
                if let Ok(n) = port.read(&mut buffer) {
                    rig.send(board, &buffer[..n]);
                }
            }
            let now = began.elapsed().as_micros() as u64;
            rig.advance(now);
            for (board, (port, _)) in ports.iter_mut().enumerate() {
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
