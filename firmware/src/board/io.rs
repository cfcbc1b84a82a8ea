//! Switches, emergency stop and driver enables: plain pins. Which is where: docs/wiring.md.

use embassy_stm32::gpio::{Input, Level, Output, Pull, Speed};
use parfocal_firmware::ports::Inputs;
use parfocal_protocol::units::AXES;

/// The input pins.
pub struct Switches {
    /// Low limit switch of each axis, pulled up.
    pub low: [Input<'static>; AXES],
    /// High limit switch of each axis, pulled up.
    pub high: [Input<'static>; AXES],
    /// Emergency stop: normally closed to ground, pulled up, so that a broken wire reads as pressed.
    pub emergency: Input<'static>,
}

impl Switches {
    /// The levels now.
    pub fn read(&self) -> Inputs {
        Inputs {
            low_switch: core::array::from_fn(|i| self.low[i].is_high()),
            high_switch: core::array::from_fn(|i| self.high[i].is_high()),
            emergency: self.emergency.is_high(),
        }
    }
}

/// An enable output. The drivers we know take low as 'on', so it starts high.
pub fn enable(pin: embassy_stm32::Peri<'static, impl embassy_stm32::gpio::Pin>) -> Output<'static> {
    Output::new(pin, Level::High, Speed::Low)
}

/// A switch input.
pub fn switch(pin: embassy_stm32::Peri<'static, impl embassy_stm32::gpio::Pin>) -> Input<'static> {
    Input::new(pin, Pull::Up)
}
