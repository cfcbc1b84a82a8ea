//! What the step interrupt costs, counted from outside: instructions from its first to its last.

use crate::Machine;
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

/// Instructions behind the last that is seen: the interrupt's return.
const TAIL: u64 = 8;

/// The interrupt, and the last thing that it writes.
const ENTRY: &str = "SysTick";
const LAST: &str = "parfocal_firmware::board::watchdog::SEEN";

/// One run of the interrupt.
#[derive(Clone, Copy, Debug)]
pub struct Service {
    /// When it began, ns.
    pub nanos: u64,
    /// Instructions.
    pub instructions: u64,
}

impl Service {
    /// The part of its period that it takes, by the reckoning above.
    pub fn load(&self) -> f64 {
        (self.instructions as f64 * CYCLES_PER_INSTRUCTION + ENTRY_CYCLES) / (PERIOD_TICKS * CYCLES_PER_TICK)
    }
}

/// Watches the interrupt of a board from now on.
///
/// # Errors
/// When the program has no such interrupt.
pub fn watch(board: &Machine) -> anyhow::Result<()> {
    board.watch_instruction(board.program.address(ENTRY)?);
    board.watch_word(board.program.address(LAST)?);
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
            // The first write after the entry is the interrupt's own: nothing interrupts it.
            found.push(Service { nanos: begin.nanos, instructions: hit.instructions - begin.instructions + TAIL });
        }
    }
    ensure!(!found.is_empty(), "the step interrupt was never seen");
    Ok(found)
}
