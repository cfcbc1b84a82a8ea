//! What the step interrupt costs, counted from outside: instructions from its first to its last.

use crate::Machine;
use crate::chip::CORE_HZ;
use crate::machine::Hit;
use anyhow::ensure;

/// Ticks of 84 MHz between two step interrupts.
const PERIOD_TICKS: f64 = parfocal_firmware::motion::SERVICE as f64;

/// Cycles of the core in a tick.
const CYCLES_PER_TICK: f64 = 2.0;

/// Cycles that an instruction takes on silicon, flash wait states and loads included; the emulation counts one.
const CYCLES_PER_INSTRUCTION: f64 = 1.5;

/// Cycles to enter and to leave an interrupt (ARM, Cortex-M4 TRM: 12 each way); the emulation takes none.
const ENTRY_CYCLES: f64 = 24.0;

/// Instructions from the last place that is seen to the interrupt's return: that function itself, and the registers popped.
const TAIL: u64 = 24;

/// The interrupt, and the last function that it calls. Both are watched as instructions: watching a word of RAM would take every
/// access to its page through the slow path, the engine's own among them.
const ENTRY: &str = "SysTick";
const LAST: &str = "parfocal_firmware::board::watchdog::check_in";

/// One run of the interrupt.
#[derive(Clone, Copy, Debug)]
pub struct Service {
    /// When it began, ns.
    pub nanos: u64,
    /// Instructions.
    pub instructions: u64,
    /// From the begin of the one before to its own, ns: more than a period when something held it up.
    pub since: u64,
}

impl Service {
    /// The part of its own time that it takes, by the reckoning above. One that was held up has more to lay, and more time.
    pub fn load(&self) -> f64 {
        let cycles = self.instructions as f64 * CYCLES_PER_INSTRUCTION + ENTRY_CYCLES;
        let period = PERIOD_TICKS * CYCLES_PER_TICK;
        cycles / (self.since as f64 * CORE_HZ as f64 / 1e9).max(period)
    }
}

/// Watches the interrupt of a board from now on.
///
/// # Errors
/// When the program has no such interrupt.
pub fn watch(board: &Machine) -> anyhow::Result<()> {
    board.watch_instruction(board.program.address(ENTRY)?);
    board.watch_instruction(board.program.address(LAST)?);
    Ok(())
}

/// The runs of the interrupt among what was seen.
///
/// # Errors
/// When there is none.
pub fn services(board_entry: u64, hits: &[Hit]) -> anyhow::Result<Vec<Service>> {
    let mut found = Vec::new();
    let mut open: Option<&Hit> = None;
    for hit in hits {
        if hit.address == board_entry {
            open = Some(hit);
        } else if let Some(begin) = open.take() {
            // The first call after the entry is the interrupt's own: nothing interrupts it.
            let since = found.last().map_or(0, |before: &Service| begin.nanos - before.nanos);
            found.push(Service {
                nanos: begin.nanos,
                instructions: hit.instructions - begin.instructions + TAIL,
                since,
            });
        }
    }
    ensure!(!found.is_empty(), "the step interrupt was never seen");
    Ok(found)
}
