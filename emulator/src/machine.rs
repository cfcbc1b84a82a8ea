//! A board that runs: the emulated core on a thread of its own, told how far to go.
//!
//! The two threads take turns: while the core runs, whoever holds the [`Machine`] waits. So a scenario reads like a
//! conversation, from top to bottom, and every run is the same.

use crate::chip::{CORE_HZ, Chip, World};
use crate::program::Program;
use anyhow::{Context, anyhow, ensure};
use rigless::device::Level;
use rigless::emulator::{self, Driver, Host as CoreHost, Settled, Start, Stop, Watch};
use rigless::image::Image;
use rigless::machine::{Board, Target, armv7m};
use rigless::mcu::Mcu;
use rigless::session::{Reset, Session};
use rigless::snapshot::Store;
use rigless::soc::Width;
use rigless::time::VirtualNanos;
use std::num::{NonZeroU32, NonZeroU64};
use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

/// The chip on its board.
#[derive(Debug)]
struct Nucleo {
    chip: Chip,
}

/// Runs are not stopped and stored.
impl Store for Nucleo {}

impl Board for Nucleo {
    fn name(&self) -> &'static str {
        "NUCLEO-F429ZI"
    }

    fn target_names(&self) -> Vec<&'static str> {
        vec!["stm32"]
    }

    fn mcu(&mut self, target: usize) -> Option<&mut dyn Mcu> {
        (target == 0).then_some(&mut self.chip)
    }

    fn targets(&mut self) -> Vec<Target<'_>> {
        let rate = NonZeroU64::new(CORE_HZ).expect("not zero");
        let core = armv7m::Core {
            variant: armv7m::Variant::M4,
            clock_hz: rate,
            interrupt_lines: NonZeroU32::new(91).expect("not zero"),
            priority_bits: 4,
            refclk_divider: NonZeroU32::new(8).expect("not zero"),
            // An instruction a clock: what a Cortex-M4 does at best.
            instructions_per_second: rate,
            boot: "flash",
        };
        let windows = rigless::cpu::armv7m::windows(self.chip.bus());
        let spec = core.spec_with_parts(&windows, armv7m::Fpu::FpV4Sp, armv7m::MpuRegions::Eight);
        vec![Target::new("stm32", &mut self.chip, spec)]
    }
}

/// Start of system memory, where ST's bootloader lies (RM0090 section 2.4).
const SYSTEM_MEMORY: u64 = 0x1fff_0000;

/// Where what stands in for it begins.
pub const BOOTLOADER: u64 = SYSTEM_MEMORY + 0x100;

/// ST's bootloader is not ours to run: a stack, an entry, and a branch to itself take its place.
fn bootloader() -> Vec<u8> {
    let mut bytes = vec![0; 0x104];
    bytes[..4].copy_from_slice(&0x2000_2000u32.to_le_bytes());
    bytes[4..8].copy_from_slice(&(BOOTLOADER as u32 | 1).to_le_bytes());
    bytes[0x100..].copy_from_slice(&0xe7fe_e7feu32.to_le_bytes());
    bytes
}

/// What the core's thread is told.
enum Order {
    /// Run up to this instant, ns.
    RunTo(u64),
    /// Put a level on a pin.
    Drive { port: char, pin: u8, high: bool },
    /// Ask for a pin's level.
    Level { port: char, pin: u8 },
    /// Hold the core, or let it go: to everything else it is as if it had masked its interrupts and spun.
    Hold(bool),
    /// Put a word into RAM.
    Poke { address: u64, value: u32 },
    /// Count instructions between these places.
    Watch(Watch),
    /// That was all.
    End,
}

/// What it answers.
enum Answer {
    At { nanos: u64, instructions: u64, resets: Vec<Reset> },
    Level(bool),
}

/// A passage of the core at a watched place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hit {
    /// The instruction's address.
    pub address: u64,
    /// Instructions executed so far.
    pub instructions: u64,
    /// ns since power-on.
    pub nanos: u64,
}

/// What is left when a run has ended.
#[derive(Debug)]
pub struct Report {
    /// Accesses to places where the chip has nothing.
    pub unmapped: Vec<String>,
    /// Accesses that the chip refused, as to a peripheral whose clock is off.
    pub refused: Vec<String>,
    /// Registers that were used and are not modelled.
    pub unimplemented: Vec<String>,
    /// What models had to say.
    pub told: Vec<String>,
    /// Passages at watched places.
    pub hits: Vec<Hit>,
    /// Resets after the first start.
    pub resets: Vec<Reset>,
}

impl Report {
    /// Nothing was touched that the chip does not have or the emulation does not know.
    ///
    /// # Errors
    /// Says what was.
    pub fn clean(&self) -> anyhow::Result<()> {
        ensure!(self.unmapped.is_empty(), "nothing lies at {}", self.unmapped.join(", "));
        ensure!(self.refused.is_empty(), "the chip refused {}", self.refused.join(", "));
        ensure!(self.unimplemented.is_empty(), "not modelled: {}", self.unimplemented.join(", "));
        ensure!(self.told.is_empty(), "{}", self.told.join("; "));
        Ok(())
    }
}

/// A board that runs.
pub struct Machine {
    /// What lies outside the chip.
    pub world: World,
    /// The program it runs.
    pub program: Program,
    orders: Sender<Order>,
    answers: Receiver<Answer>,
    thread: JoinHandle<anyhow::Result<Report>>,
    nanos: u64,
    instructions: u64,
    resets: Vec<Reset>,
}

impl Machine {
    /// Switches the power on.
    ///
    /// # Errors
    /// When the ELF cannot be read.
    pub fn start(elf: &Path) -> anyhow::Result<Self> {
        Self::start_with(elf, Arc::default())
    }

    /// Switches the power on of a board whose flash bank 2 holds what another one left in it.
    ///
    /// # Errors
    /// When the ELF cannot be read.
    pub fn start_with(elf: &Path, flash: Arc<Mutex<Vec<u8>>>) -> anyhow::Result<Self> {
        let kept = flash.lock().expect("nothing else runs").clone();
        let program = Program::read(elf)?;
        let mut images = vec![Image::read(elf, None).map_err(|e| anyhow!("{}: {e}", elf.display()))?];
        let mut place = |name: &str, bytes, at| -> anyhow::Result<()> {
            images.push(Image::new(Path::new(name), bytes, Some(at)).map_err(|e| anyhow!("{name}: {e}"))?);
            Ok(())
        };
        place("bootloader", bootloader(), SYSTEM_MEMORY)?;
        if !kept.is_empty() {
            place("flash bank 2", kept, crate::flash::BANK_2)?;
        }
        let world = World { flash, ..World::default() };
        let outside = world.clone();
        let (orders, inbox) = channel();
        let (outbox, answers) = channel();
        let thread = std::thread::spawn(move || {
            let board = Box::new(Nucleo { chip: Chip::new(&outside) });
            let session = Session::new(board, 0, VirtualNanos(1)).map_err(|e| anyhow!("{e}"))?;
            let runner = Runner { inbox, outbox, hits: Vec::new() };
            let finished =
                emulator::run(session, &Start::new(&images), runner).map_err(|e| anyhow!("the run failed: {e}"))?;
            let session = finished.session;
            Ok(Report {
                unmapped: session.unmapped().iter().map(|u| format!("{u:x?}")).collect(),
                refused: session.refused().iter().map(|(at, fault)| format!("{at:#x}: {fault}")).collect(),
                unimplemented: session
                    .unimplemented()
                    .values()
                    .map(|u| format!("{}.{}", u.instance, u.register))
                    .collect(),
                told: session.told().map(|t| format!("{}.{}: {}", t.instance, t.register, t.reason)).collect(),
                hits: finished.driver.hits,
                resets: session.resets().to_vec(),
            })
        });
        let mut machine =
            Self { world, program, orders, answers, thread, nanos: 0, instructions: 0, resets: Vec::new() };
        machine.wait()?;
        Ok(machine)
    }

    fn tell(&self, order: Order) {
        // A core that has stopped says why when the next answer does not come.
        let _ = self.orders.send(order);
    }

    fn wait(&mut self) -> anyhow::Result<()> {
        match self.answers.recv().context("the core stopped")? {
            Answer::At { nanos, instructions, resets } => {
                (self.nanos, self.instructions, self.resets) = (nanos, instructions, resets);
            }
            Answer::Level(_) => unreachable!("nothing was asked for"),
        }
        Ok(())
    }

    /// Lets the board run for a while.
    ///
    /// # Errors
    /// When the core has stopped for good.
    pub fn run_for(&mut self, span: Duration) -> anyhow::Result<()> {
        self.tell(Order::RunTo(self.nanos + span.as_nanos() as u64));
        self.wait()
    }

    /// Time since power-on.
    pub fn now(&self) -> Duration {
        Duration::from_nanos(self.nanos)
    }

    /// Instructions executed so far.
    pub fn instructions(&self) -> u64 {
        self.instructions
    }

    /// Puts a level on an input pin, as 'E', 7 for PE7.
    pub fn drive(&self, (port, pin): (char, u8), high: bool) {
        self.tell(Order::Drive { port, pin, high });
    }

    /// The level on a pin.
    ///
    /// # Errors
    /// When the core has stopped for good.
    pub fn level(&mut self, (port, pin): (char, u8)) -> anyhow::Result<bool> {
        self.tell(Order::Level { port, pin });
        match self.answers.recv().context("the core stopped")? {
            Answer::Level(high) => Ok(high),
            Answer::At { .. } => unreachable!("it does not run"),
        }
    }

    /// Resets since power-on: when, and who asked for them.
    pub fn resets(&self) -> &[Reset] {
        &self.resets
    }

    /// Holds the core, or lets it go, while everything else goes on: as if it had masked its interrupts and spun.
    pub fn hold(&self, held: bool) {
        self.tell(Order::Hold(held));
    }

    /// Puts a word into the program's RAM: a fault that a cosmic ray or a bug might make.
    pub fn poke(&self, address: u64, value: u32) {
        self.tell(Order::Poke { address, value });
    }

    /// Counts passages at an instruction, from now on.
    pub fn watch_instruction(&self, address: u64) {
        self.tell(Order::Watch(Watch::Instruction(address)));
    }

    /// Switches off, and says what is left.
    ///
    /// # Errors
    /// When the run failed.
    pub fn stop(self) -> anyhow::Result<Report> {
        self.tell(Order::End);
        self.thread.join().map_err(|_| anyhow!("the core's thread panicked"))?
    }
}

/// The core's side of the turns.
struct Runner {
    inbox: Receiver<Order>,
    outbox: Sender<Answer>,
    hits: Vec<Hit>,
}

impl Driver<Nucleo> for Runner {
    fn on_settled(&mut self, _: &mut Session<Nucleo>, _: &mut dyn CoreHost, settled: Settled) {
        if let Settled::Hit(hit) = settled {
            self.hits.push(Hit { address: hit.address, instructions: hit.instruction_count, nanos: hit.at.0 });
        }
    }

    fn on_stop(&mut self, session: &mut Session<Nucleo>, stop: Stop, core: &mut dyn CoreHost) -> Option<VirtualNanos> {
        let resets = session.resets().to_vec();
        let at = Answer::At { nanos: stop.at.0, instructions: stop.instruction_count, resets };
        self.outbox.send(at).ok()?;
        // No order means that nobody wants the board any more.
        while let Ok(order) = self.inbox.recv() {
            match order {
                Order::RunTo(nanos) => return Some(VirtualNanos(nanos.max(stop.at.0 + 1))),
                Order::Drive { port, pin, high } => {
                    let level = if high { Level::High } else { Level::Low };
                    session.board_mut().chip.drive(stop.at, port, pin, Some(level));
                }
                Order::Level { port, pin } => {
                    self.outbox.send(Answer::Level(session.board().chip.level(port, pin))).ok()?;
                }
                Order::Hold(held) => core.hold(held),
                // Not RAM: an error of the scenario, which ends the run.
                Order::Poke { address, value } => core.write(address, Width::W32, value.into()).ok()?,
                Order::Watch(watch) => session.watch(watch),
                Order::End => return None,
            }
        }
        None
    }
}
