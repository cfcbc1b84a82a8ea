//! The random number generator (RM0090 chapter 24): ready at once, and the same numbers in every run.

use rigless::device::{Device, DeviceContext, Level, RegisterFile};
use rigless::soc::stm32f427::generated::rng::{Register, cr};

/// Position of its interrupt.
const HASH_RNG: usize = 0;

/// The generator.
#[derive(Debug)]
pub struct Random {
    state: u32,
}

impl Random {
    /// Numbers that follow from `seed`.
    pub fn new(seed: u32) -> Self {
        Self { state: seed }
    }

    fn next(&mut self) -> u32 {
        self.state = self.state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        self.state.rotate_left(16)
    }
}

impl Device for Random {
    type Register = Register;

    fn read(&mut self, register: Register, registers: &mut RegisterFile, _: &mut DeviceContext<'_>) -> Option<u64> {
        let on = cr::RNGEN.is_set(registers.get(Register::Cr));
        match register {
            Register::Cr => None,
            // DRDY
            Register::Sr => Some(u64::from(on)),
            Register::Dr => Some(if on { self.next().into() } else { 0 }),
        }
    }

    fn write(&mut self, _: Register, _: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let value = registers.get(Register::Cr);
        let due = cr::RNGEN.is_set(value) && cr::IE.is_set(value);
        context.interrupt(HASH_RNG, if due { Level::High } else { Level::Low });
    }
}
