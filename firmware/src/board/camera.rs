//! The camera's trigger output, PA0: TIM5, which counts the records of one axis.
//!
//! The axis' timer gives a trigger at every update (CR2.MMS, RM0090 section 18.4.2), and TIM5 counts them: external clock mode 1
//! (section 18.3.3) from the internal trigger that section 18.4.3, table 97, assigns. Its channel 1 goes high as the count
//! reaches CCR1 (OC1M = 001, section 18.4.7), so the pulse begins with the record, a fixed few clocks of synchronisation after
//! STEP, however late the software is. It ends by software, 0.1 to 0.2 ms later.
//!
//! TIM5 hears TIM2, TIM3 and TIM4, not TIM1: the fourth axis has no trigger.

use embassy_stm32::pac::TIM5;
use embassy_stm32::pac::timer::vals::{Ocm, Sms, Ts};

/// The trigger input of TIM5 that an axis' timer drives.
pub fn source(axis: usize) -> Option<Ts> {
    match axis {
        0 => Some(Ts::ITR0),
        1 => Some(Ts::ITR1),
        2 => Some(Ts::ITR2),
        _ => None,
    }
}

/// Output low; nothing counted. The step timers are about to start from record 0.
pub fn reset() {
    disarm();
    TIM5.cr1().write(|w| w.set_cen(false));
    TIM5.arr().write_value(u32::MAX);
    TIM5.cnt().write_value(0);
    TIM5.ccer().write(|w| w.set_cce(0, true));
}

/// Counts an axis' records from now on, `playing` being the one that plays and going to play for a while.
pub fn follow(axis: usize, playing: u32) -> bool {
    let Some(source) = source(axis) else { return false };
    disarm();
    TIM5.cr1().write(|w| w.set_cen(false));
    TIM5.smcr().write(|w| w.set_ts(source));
    TIM5.smcr().modify(|w| w.set_sms(Sms::EXT_CLOCK_MODE));
    TIM5.cnt().write_value(begins(playing));
    TIM5.cr1().write(|w| w.set_cen(true));
    true
}

/// The count with which a record begins: the timer's first update begins record 0.
fn begins(record: u32) -> u32 {
    record.wrapping_add(1)
}

/// High from the begin of a record on. False when it begins too soon.
pub fn arm(record: u32) -> bool {
    let at = begins(record);
    let ahead = || at.wrapping_sub(TIM5.cnt().read()) as i32;
    if ahead() < 2 {
        return false;
    }
    TIM5.ccr(0).write_value(at);
    TIM5.sr().write(|w| w.set_ccif(0, false));
    TIM5.ccmr_output(0).write(|w| w.set_ocm(0, Ocm::ACTIVE_ON_MATCH));
    if ahead() > 0 || fired() {
        return true;
    }
    // It came between the two looks.
    disarm();
    false
}

/// Whether the record has begun.
pub fn fired() -> bool {
    TIM5.sr().read().ccif(0)
}

/// Low.
pub fn disarm() {
    TIM5.ccmr_output(0).write(|w| w.set_ocm(0, Ocm::FORCE_INACTIVE));
    TIM5.sr().write(|w| w.set_ccif(0, false));
}
