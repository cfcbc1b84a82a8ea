//! `parfocal simulate`: the simulated rig for other programs, in real time.

use super::connection::Connection;
use super::remembered::Memory;
use super::simulated::manipulators;
use super::{Output, interrupt};
use anyhow::{Context, bail};
use parfocal::rig::ManipulatorNumber;
use parfocal_simulator::model::RigModel;
use parfocal_simulator::rig::Rig;
use serialport::{SerialPort, TTYPort};
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::time::{Duration, Instant};

/// Offer the simulated rig's boards on pseudo-terminals, in real time, or move by hand what no motor moves
#[derive(Debug, clap::Args)]
#[command(group(clap::ArgGroup::new("what").required(true).args(["pty", "set_down"])))]
pub struct Arguments {
    /// One pseudo-terminal a board; their names are printed, and work as --port of any program
    #[arg(long)]
    pty: bool,
    /// Set a manipulator down elsewhere, by so many µm in ref, as a hand would: no axis knows of it; needs --rig
    #[arg(long, value_name = "mN=X,Y,Z", value_parser = set_down, allow_hyphen_values = true)]
    set_down: Vec<(ManipulatorNumber, [f64; 3])>,
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
    /// When the system gives no pseudo-terminal, or a manipulator cannot be set down.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        if !self.set_down.is_empty() {
            return self.by_hand(connection, out);
        }
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

    fn by_hand(&self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let path = connection.rig.as_deref().context("give --rig FILE: the simulated rig is remembered beside it")?;
        if !connection.is_simulated() {
            bail!("{} is no simulated rig: a real manipulator is set down by your own hands", path.display());
        }
        let memory = Memory::beside(path);
        let mut left = memory.recall()?;
        let mut text = String::new();
        for (number, by) in &self.set_down {
            if !manipulators().any(|known| known == *number) {
                bail!("the simulated rig has no {number}: it has m1 and m2");
            }
            let stands = left.set_down.entry(*number).or_default();
            stands.iter_mut().zip(by).for_each(|(stands, by)| *stands += by);
            let [x, y, z] = stands;
            text += &format!("{number} now stands {x}, {y}, {z} µm from where it was built in; no axis knows of it\n");
        }
        memory.keep(&left)?;
        let stands: BTreeMap<String, [f64; 3]> = left.set_down.iter().map(|(n, by)| (n.to_string(), *by)).collect();
        out.result(&text, &serde_json::json!({ "set_down_um": stands }))
    }
}

/// Reads `m1=900,-700,500`.
fn set_down(text: &str) -> Result<(ManipulatorNumber, [f64; 3]), String> {
    let wrong = || format!("'{text}' sets nothing down: write mN=X,Y,Z in µm, as in m1=900,-700,500");
    let (name, by) = text.split_once('=').ok_or_else(wrong)?;
    let number = name.trim().parse().map_err(|_| wrong())?;
    let by: Vec<f64> = by.split(',').filter_map(|v| v.trim().parse().ok()).collect();
    let by: [f64; 3] = by.try_into().map_err(|_| wrong())?;
    if by.iter().all(|um| um.abs() <= FARTHEST_UM) {
        Ok((number, by))
    } else {
        Err(format!("'{text}': a hand sets it down within {FARTHEST_UM} µm each way"))
    }
}

/// As far as a hand moves a simulated manipulator, µm.
const FARTHEST_UM: f64 = 20_000.0;
