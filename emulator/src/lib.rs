//! The flashed ELF on an emulated STM32F429.
//!
//! [`Machine`] is a NUCLEO-F429ZI as far as the firmware can tell: a Cortex-M4 that executes the release ELF instruction by
//! instruction, the chip's peripherals, a USB host and a serial port at its far ends, and a recorder on every STEP and DIR
//! pin. [`Talk`] speaks the protocol with it. `scenarios` holds what is tried, and what must come of it.
//!
//! The core and most register models are [rigless]'s, of the STM32F427, which is this chip without its display controller.
//! What rigless lacks stands here: the timers' DMA requests ([`chip`]), flash that keeps what is written ([`flash`]), random
//! numbers ([`random`]) and USB in device role ([`usb`]).
//!
//! What the emulation cannot show: an instruction takes one clock, whatever flash and buses do; entering an interrupt takes
//! none; DMA takes no time. Where a figure stands for cycles it says how it was reckoned. Driver and USB model agreeing is no
//! proof of USB compliance.
//!
//! [rigless]: https://docs.rs/rigless

pub mod chip;
pub mod exact;
pub mod figures;
pub mod flash;
pub mod machine;
pub mod planned;
pub mod program;
pub mod random;
pub mod scenarios;
pub mod serial;
pub mod service;
pub mod talk;
pub mod trace;
pub mod usb;
pub mod usb_host;

pub use machine::Machine;
pub use talk::Talk;
