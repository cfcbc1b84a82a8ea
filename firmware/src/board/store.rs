//! Settings in flash bank 2, written in the background while the program runs on from bank 1 (RM0090 section 3.6.5: a bank
//! can be read while the other is erased).

use super::Irqs;
use embassy_stm32::Peri;
use embassy_stm32::flash::{Async, Bank2Region1, Flash};
use embassy_stm32::peripherals::FLASH;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Duration, with_timeout};
use parfocal_firmware::keeping::Store;
use parfocal_firmware::ports::{Keep, Kept};

/// The first region of bank 2: four sectors of 16 KiB from 0x0810_0000 (RM0090 table 6).
const SETTINGS_BYTES: u32 = 4 * 16 * 1024;

/// A sector is erased in at most 0.8 s (DS9405 table 48), and one writing may need two.
const LONGEST: Duration = Duration::from_secs(3);

/// What waits to be written. Axes, board and position, twice over.
static WAITING: Channel<CriticalSectionRawMutex, Keep, 12> = Channel::new();

/// Queues something to be written; false when the queue is full.
pub fn keep(what: Keep) -> bool {
    WAITING.try_send(what).is_ok()
}

/// The settings in flash. Only where [`super::start::can_save`] says so: on older silicon bank 2 must not be read.
pub struct Settings(Store<Bank2Region1<'static, Async>>);

impl Settings {
    /// Takes the flash.
    pub fn new(flash: Peri<'static, FLASH>) -> Self {
        let region = Flash::new(flash, Irqs).into_regions().bank2_region1;
        Self(Store::new(region, 0..SETTINGS_BYTES))
    }

    /// Reads what was kept.
    pub async fn load(&mut self) -> Kept {
        self.0.load().await
    }
}

/// Writes what is queued, for ever. The watchdog does not wait for it: an erasure takes longer.
#[embassy_executor::task]
pub async fn run(mut settings: Settings) -> ! {
    loop {
        let what = WAITING.receive().await;
        match with_timeout(LONGEST, settings.0.keep(&what)).await {
            Ok(Ok(())) => {}
            Ok(Err(_)) => defmt::error!("settings could not be written"),
            Err(_) => defmt::error!("the flash did not finish writing in time"),
        }
    }
}
