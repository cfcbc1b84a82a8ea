//! The independent watchdog: petted only when every part of the program has checked in since the last time.

use core::sync::atomic::{AtomicU32, Ordering};
use embassy_stm32::Peri;
use embassy_stm32::peripherals::IWDG;
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_time::{Duration, Timer};

/// Who has to check in. A part that waits for something wakes at least every [`LAP`] to do so.
#[derive(Clone, Copy)]
pub enum Part {
    /// The step interrupt.
    Steps,
    /// The controller.
    Control,
    /// USB, receiving and sending.
    UsbReceiver,
    /// USB, sending.
    UsbSender,
    /// USART3, receiving.
    SerialReceiver,
    /// USART3, sending.
    SerialSender,
}

const EVERY_PART: u32 = (1 << (Part::SerialSender as u32 + 1)) - 1;

static SEEN: AtomicU32 = AtomicU32::new(0);

/// Longest time that a part may wait before it checks in again.
pub const LAP: Duration = Duration::from_millis(5);

/// 26 ms by the nominal 32 kHz of the LSI, whose real frequency is 17 to 47 kHz (DS9405 table 42): between 18 and 49 ms.
const TIMEOUT_US: u32 = 26_000;

/// Says that a part is alive. A function of its own, so that the emulator sees where the step interrupt ends.
#[inline(never)]
pub fn check_in(part: Part) {
    SEEN.fetch_or(1 << part as u32, Ordering::Relaxed);
}

/// Starts the watchdog and pets it for ever, as long as all check in.
#[embassy_executor::task]
pub async fn watch(iwdg: Peri<'static, IWDG>) -> ! {
    let mut watchdog = IndependentWatchdog::new(iwdg, TIMEOUT_US);
    watchdog.unleash();
    // Starting loads the longest time (RM0090 section 21.3); the first reload sets ours.
    watchdog.pet();
    loop {
        Timer::after(LAP).await;
        if SEEN.load(Ordering::Relaxed) == EVERY_PART {
            SEEN.store(0, Ordering::Relaxed);
            watchdog.pet();
        }
    }
}
