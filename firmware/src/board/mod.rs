//! The board itself: NUCLEO-F429ZI. The one place where registers are touched and unsafe code is allowed.
//!
//! Facts cite RM0090 (reference manual), DS9405 (data sheet), ES0206 (errata) and UM1974 (the Nucleo board), all by ST.
#![allow(unsafe_code, reason = "registers, interrupts and RAM shared with DMA; each use says why it is sound")]

mod camera;
pub mod clocks;
mod fault;
pub mod io;
mod last_words;
pub mod links;
mod nucleo;
pub mod pulses;
pub mod serial;
pub mod start;
pub mod store;
mod timers;
pub mod usb;
pub mod watchdog;

// The log goes to the debugger through RTT.
use defmt_rtt as _;
pub use nucleo::run;

use embassy_stm32::gpio::Output;
use embassy_stm32::{bind_interrupts, dma, flash, peripherals, rng, usart, usb as otg};
use io::Switches;
use parfocal_firmware::motion::Engine;
use parfocal_firmware::ports::{Board, Inputs, Keep};
use parfocal_protocol::units::AXES;

bind_interrupts!(
    /// Interrupts that embassy's drivers handle. The step interrupt is SysTick, in [`pulses`].
    pub struct Irqs {
        USART3 => usart::InterruptHandler<peripherals::USART3>;
        DMA1_STREAM1 => dma::InterruptHandler<peripherals::DMA1_CH1>;
        DMA1_STREAM3 => dma::InterruptHandler<peripherals::DMA1_CH3>;
        OTG_FS => otg::InterruptHandler<peripherals::USB_OTG_FS>;
        FLASH => flash::InterruptHandler;
        HASH_RNG => rng::InterruptHandler<peripherals::RNG>;
    }
);

/// The hardware below the controller.
pub struct Nucleo {
    /// Limit switches and emergency stop.
    pub switches: Switches,
    /// Driver enables, low is on.
    pub enables: [Output<'static>; AXES],
    /// Whether settings can be kept on this silicon.
    pub can_save: bool,
}

impl Board for Nucleo {
    fn pulses<R>(&mut self, f: impl FnOnce(&mut Engine) -> R) -> R {
        pulses::with(f)
    }

    fn inputs(&mut self) -> Inputs {
        self.switches.read()
    }

    fn enable(&mut self, axis: usize, on: bool) {
        if let Some(pin) = self.enables.get_mut(axis) {
            pin.set_level((!on).into());
        }
    }

    fn outputs_off(&mut self) {
        pulses::stop();
    }

    fn outputs_on(&mut self) {
        pulses::restart();
    }

    fn keep(&mut self, what: Keep) -> bool {
        self.can_save && store::keep(what)
    }

    fn has_trigger(&self, axis: usize) -> bool {
        pulses::has_trigger(axis)
    }

    fn has_bootloader(&self) -> bool {
        true
    }

    fn enter_bootloader(&mut self) {
        pulses::force_inactive();
        start::restart_into_bootloader()
    }
}
