//! The first instructions of a run: why it started, who the board is, or off into the bootloader.

use super::last_words::{self, LastWords};
use embassy_stm32::pac;
use parfocal_firmware::ports::Identity;
use parfocal_protocol::message::{Label, ResetCause};
use parfocal_protocol::units::AXES;

/// Start of the chip's own bootloader, 'system memory' (RM0090 section 2.4, AN2606).
const SYSTEM_MEMORY: *const u32 = 0x1fff_0000 as *const u32;

/// First silicon revision on which flash bank 2 can be read while PA12 (USB) is in use (ES0206 section 2.2.14).
const REVISION_WITHOUT_ERRATUM: u16 = 0x2001;

/// Enters the bootloader if the last run asked for it; else says why this run began. Call it before anything else.
pub fn cause() -> ResetCause {
    let words = last_words::take();
    if matches!(words, LastWords::Bootloader) {
        bootloader();
    }
    // RM0090 section 6.3.21: the flags pile up until RMVF clears them.
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    match words {
        LastWords::Panic(text) => {
            defmt::error!("the last run panicked: {}", text.as_str());
            ResetCause::Panic
        }
        _ if flags.wdgrstf() || flags.wwdgrstf() => ResetCause::Watchdog,
        _ if flags.sftrstf() => ResetCause::Software,
        _ if flags.porrstf() || flags.borrstf() => ResetCause::Power,
        _ => ResetCause::Pin,
    }
}

/// Jumps into the bootloader, right after a reset: no clock, interrupt or watchdog of ours runs yet.
fn bootloader() -> ! {
    pac::RCC.apb2enr().modify(|w| w.set_syscfgen(true));
    // The bootloader expects its own memory at address 0 (RM0090 section 9.2.1).
    pac::SYSCFG.memrm().modify(|w| w.set_mem_mode(1));
    // SAFETY: system memory begins with the bootloader's vector table, burnt in by ST.
    unsafe { cortex_m::asm::bootload(SYSTEM_MEMORY) }
}

/// Restarts into the bootloader.
pub fn restart_into_bootloader() -> ! {
    last_words::ask_for_bootloader();
    cortex_m::peripheral::SCB::sys_reset()
}

/// Whether settings can be read from and written to flash bank 2 on this silicon.
pub fn can_save() -> bool {
    pac::DBGMCU.idcode().read().rev_id() >= REVISION_WITHOUT_ERRATUM
}

/// Who this board is.
pub fn identity(boot: u32, reset: ResetCause) -> Identity {
    Identity {
        board: Label::new("NUCLEO-F429ZI"),
        git: Label::new(env!("PARFOCAL_GIT")),
        unique_id: embassy_stm32::uid::uid(),
        boot,
        reset,
        axes: AXES as u8,
        can_save: can_save(),
    }
}
