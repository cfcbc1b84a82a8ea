//! When the program cannot go on: outputs inactive first, then the reason kept for the next start, then a reset.

use super::{last_words, pulses};
use core::fmt::Display;
use core::panic::PanicInfo;
use cortex_m::peripheral::{DCB, SCB};
use cortex_m_rt::{ExceptionFrame, exception};

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    end(info)
}

/// A bus, memory or usage fault: this program enables none of the finer handlers, so all arrive here.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    end(format_args!("hard fault at {:#010x}, called from {:#010x}", frame.pc(), frame.lr()))
}

/// An interrupt that nothing handles.
#[exception]
unsafe fn DefaultHandler(number: i16) {
    end(format_args!("interrupt {number} has no handler"))
}

fn end(reason: impl Display) -> ! {
    cortex_m::interrupt::disable();
    pulses::force_inactive();
    last_words::keep_panic(&reason);
    defmt::error!("{}", defmt::Display2Format(&reason));
    // With a debugger attached, stop here and let a person look.
    if DCB::is_debugger_attached() {
        cortex_m::asm::bkpt();
    }
    SCB::sys_reset()
}
