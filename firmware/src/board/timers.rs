//! The step timers and their DMA streams: one timer an axis, whose registers a DMA burst reloads at every update.
//!
//! | axis | timer | STEP, channel 1 | DIR, channel 2 | update request |
//! |---|---|---|---|---|
//! | 0 | TIM2 | PA5 | PB3 | DMA1 stream 7 channel 3 |
//! | 1 | TIM3 | PC6 | PC7 | DMA1 stream 2 channel 5 |
//! | 2 | TIM4 | PD12 | PD13 | DMA1 stream 6 channel 2 |
//! | 3 | TIM1 | PE9 | PE11 | DMA2 stream 5 channel 6 |
//!
//! (RM0090 tables 42 and 43.) TIM5 would be the natural fourth, but its channel 2 exists only on PA1, which the Nucleo's
//! Ethernet PHY drives, and no burst of four words from ARR reaches another channel. TIM1 runs at 168 MHz and is divided
//! by 2. DMA2 moves data to APB2 only, so the erratum of data corrupted when it serves AHB and APB2 peripherals at the same time
//! (ES0206) does not arise.
//!
//! **The burst.** At an update the timer takes over what was preloaded and asks for the next record; the stream writes its
//! four words through DMAR to ARR, the register behind it (unused; RCR of TIM1, where 0 means none), CCR1 and CCR2. The
//! record fetched at update k plays from update k + 1. Words, not half-words: the bus bridge would put a half-word on both
//! halves of TIM2's 32-bit ARR. FIFO with full threshold and memory bursts of four: one burst fetches exactly one record.

use super::camera;
use embassy_stm32::gpio::OutputType;
use embassy_stm32::peripherals::TIM5;
use embassy_stm32::timer::low_level::Timer;
use embassy_stm32::timer::simple_pwm::PwmPin;
use embassy_stm32::timer::{Ch1, Ch2, GeneralInstance4Channel, TimerPin, UpDma};
use embassy_stm32::{Peri, pac};
use pac::dma::vals::{Burst, Dir, Dmdis, Fth, Pl, Size};
use pac::timer::TimGp16;
use pac::timer::vals::{Mms, Ocm};
use parfocal_firmware::motion::{RING, Record, StepTimers};
use parfocal_protocol::units::AXES;

/// Words of a record.
const WORDS: usize = size_of::<Record>() / 4;
const _: () = assert!(WORDS == 4 && align_of::<Record>() == 16, "a record is one aligned burst");

/// Length of the first period, ticks: the records begin after it.
const FIRST: u16 = 168;

/// One axis' timer and stream.
#[derive(Clone, Copy)]
struct Channel {
    timer: TimGp16,
    dma: pac::dma::Dma,
    stream: usize,
    request: u8,
    /// Divides the timer's clock to the 84 MHz of a tick.
    prescaler: u16,
}

/// The same registers at the same places, of a 16-bit timer: TIM2 counts in 32 bits and TIM1 knows more, but the records need
/// neither.
const fn general(timer: *mut ()) -> TimGp16 {
    // SAFETY: called below with TIM1 and TIM2, whose maps contain that of a general 16-bit timer (RM0090 sections 17.4, 18.4).
    unsafe { TimGp16::from_ptr(timer) }
}

/// The axes' hardware.
const CHANNELS: [Channel; AXES] = [
    Channel { timer: general(pac::TIM2.as_ptr()), dma: pac::DMA1, stream: 7, request: 3, prescaler: 0 },
    Channel { timer: pac::TIM3, dma: pac::DMA1, stream: 2, request: 5, prescaler: 0 },
    Channel { timer: pac::TIM4, dma: pac::DMA1, stream: 6, request: 2, prescaler: 0 },
    Channel { timer: general(pac::TIM1.as_ptr()), dma: pac::DMA2, stream: 5, request: 6, prescaler: 1 },
];

/// Proof that the timers, streams and pins are ours, and set up.
pub struct StepHardware(());

impl StepHardware {
    /// One axis: its timer's clock on, its pins the timer's. The types prove that pins and stream belong to the timer.
    pub fn claim<T: GeneralInstance4Channel, D: UpDma<T>>(
        timer: Peri<'static, T>,
        stream: Peri<'static, D>,
        step: Peri<'static, impl TimerPin<T, Ch1>>,
        dir: Peri<'static, impl TimerPin<T, Ch2>>,
    ) {
        // Dropping either would give the clock or the pin back.
        core::mem::forget(Timer::new(timer));
        core::mem::forget((PwmPin::new(step, OutputType::PushPull), PwmPin::new(dir, OutputType::PushPull), stream));
    }

    /// The camera's output and the timer that makes its pulses.
    pub fn claim_camera(timer: Peri<'static, TIM5>, pin: Peri<'static, impl TimerPin<TIM5, Ch1>>) {
        core::mem::forget(Timer::new(timer));
        core::mem::forget(PwmPin::new(pin, OutputType::PushPull));
    }

    /// All axes are claimed.
    pub fn all_claimed() -> Self {
        // TIM1's outputs have a master switch (RM0090 section 17.4.18).
        pac::TIM1.bdtr().modify(|w| w.set_moe(true));
        Self(())
    }

    /// Points an axis' stream at its ring and loads the first record; the timer does not run yet.
    ///
    /// # Safety
    /// DMA reads the ring until [`Self::freeze`]: it must stay where it is, in RAM that the DMA reaches (not CCM).
    pub unsafe fn load(&mut self, axis: usize, ring: *const [Record; RING]) {
        let Channel { timer, dma, stream, request, prescaler } = CHANNELS[axis];
        let s = dma.st(stream);
        s.par().write_value(timer.dmar().as_ptr() as u32);
        s.m0ar().write_value(ring as u32);
        s.ndtr().write(|w| w.set_ndt((RING * WORDS) as u16));
        s.fcr().write(|w| {
            w.set_dmdis(Dmdis::DISABLED); // DMDIS = 1: through the FIFO
            w.set_fth(Fth::FULL);
        });
        // Flags of an earlier run keep a stream from starting (RM0090 section 10.3.18).
        dma.ifcr(stream / 4).write(|w| {
            let n = stream % 4;
            w.set_tcif(n, true);
            w.set_htif(n, true);
            w.set_teif(n, true);
            w.set_dmeif(n, true);
            w.set_feif(n, true);
        });
        s.cr().write(|w| {
            w.set_chsel(request);
            w.set_dir(Dir::MEMORY_TO_PERIPHERAL);
            w.set_minc(true);
            w.set_circ(true);
            w.set_msize(Size::BITS32);
            w.set_psize(Size::BITS32);
            w.set_mburst(Burst::INCR4);
            w.set_pl(Pl::VERY_HIGH);
        });
        s.cr().modify(|w| w.set_en(true));

        timer.psc().write_value(prescaler);
        // DCR counts registers from CR1: ARR is the eleventh; four transfers (RM0090 section 18.4.17).
        timer.dcr().write(|w| {
            w.set_dba(11);
            w.set_dbl(WORDS as u8 - 1);
        });
        timer.ccmr_output(0).write(|w| {
            for channel in 0..2 {
                w.set_ocm(channel, Ocm::PWM_MODE1);
                w.set_ocpe(channel, true);
            }
        });
        for channel in 0..2 {
            timer.ccr(channel).write(|w| w.set_ccr(0));
        }
        timer.arr().write(|w| w.set_arr(FIRST - 1));
        timer.cnt().write(|w| w.set_cnt(0));
        timer.cr1().write(|w| w.set_arpe(true));
        // Every update goes to the timer that counts records for the camera.
        timer.cr2().write(|w| w.set_mms(Mms::UPDATE));
        timer.dier().write(|w| w.set_ude(true));
        // Takes the silence above into force, and asks the stream for record 0.
        timer.egr().write(|w| w.set_ug(true));
        timer.ccer().write(|w| {
            w.set_cce(0, true);
            w.set_cce(1, true);
        });
    }

    /// Starts all timers, a few ticks after one another, always alike.
    pub fn run(&mut self) {
        camera::reset();
        for channel in &CHANNELS {
            channel.timer.cr1().modify(|w| w.set_cen(true));
        }
    }

    /// Stops an axis' timer and stream; gives NDTR and CNT. The outputs keep their levels: no edge comes of it.
    pub fn freeze(&mut self, axis: usize) -> (u32, u32) {
        let Channel { timer, dma, stream, .. } = CHANNELS[axis];
        timer.cr1().modify(|w| w.set_cen(false));
        // Without requests the burst that is under way ends, and none follows.
        timer.dier().write(|w| w.set_ude(false));
        let count = u32::from(timer.cnt().read().cnt());
        let s = dma.st(stream);
        let left = u32::from(s.ndtr().read().ndt());
        s.cr().modify(|w| w.set_en(false));
        while s.cr().read().en() {}
        (left, count)
    }
}

impl StepTimers for StepHardware {
    fn left(&mut self, axis: usize) -> u32 {
        let Channel { dma, stream, .. } = CHANNELS[axis];
        u32::from(dma.st(stream).ndtr().read().ndt())
    }

    fn follow(&mut self, axis: usize, playing: u32, ticks: u32) -> bool {
        let Some(Channel { timer, .. }) = CHANNELS.get(axis) else { return false };
        // Neither just begun nor about to end: the record that plays is certain for the few instructions that follow.
        let count = u32::from(timer.cnt().read().cnt());
        count >= 400 && count + 400 < ticks && camera::follow(axis, playing)
    }

    fn arm(&mut self, record: u32) -> bool {
        camera::arm(record)
    }

    fn fired(&mut self) -> bool {
        camera::fired()
    }

    fn disarm(&mut self) {
        camera::disarm();
    }

    fn wake(&mut self, axis: usize) {
        CHANNELS[axis].timer.egr().write(|w| w.set_ug(true));
    }

    fn count(&mut self, axis: usize) -> Option<u32> {
        Some(u32::from(CHANNELS[axis].timer.cnt().read().cnt()))
    }

    fn clock(&mut self) -> u32 {
        cortex_m::peripheral::DWT::cycle_count()
    }
}

/// Stops every timer where it stands, whatever the program was doing: no edge follows. For faults and panics.
pub fn stop_all() {
    for channel in &CHANNELS {
        channel.timer.cr1().modify(|w| w.set_cen(false));
    }
}
