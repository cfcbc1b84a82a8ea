//! The clock tree: 168 MHz for the core, 84 MHz for the step timers, 48 MHz for USB (RM0090 section 6.2).

use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::pac;
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk, mux,
};
use embassy_stm32::time::Hertz;

/// Frequency of the core.
pub const CORE_HZ: u32 = 168_000_000;

/// Everything below the step interrupt, which alone has the highest priority.
const BELOW_STEPS: Priority = Priority::P6;

/// The board's clocks: the ST-LINK gives 8 MHz (HSE bypass, UM1974 section 6.8).
pub fn config() -> embassy_stm32::Config {
    let mut config = embassy_stm32::Config::default();
    let rcc = &mut config.rcc;
    rcc.hse = Some(Hse { freq: Hertz(8_000_000), mode: HseMode::Bypass });
    rcc.pll_src = PllSource::HSE;
    // 8 MHz / 4 * 168 = 336 MHz; / 2 for the core; / 7 = 48 MHz for USB and the random numbers.
    rcc.pll = Some(Pll {
        prediv: PllPreDiv::DIV4,
        mul: PllMul::MUL168,
        divp: Some(PllPDiv::DIV2),
        divq: Some(PllQDiv::DIV7),
        divr: None,
    });
    rcc.sys = Sysclk::PLL1_P;
    rcc.ahb_pre = AHBPrescaler::DIV1;
    // APB1 runs at 42 MHz, its timers at twice that (RM0090 section 6.2, figure 16): the unit of `Ticks`.
    rcc.apb1_pre = APBPrescaler::DIV4;
    rcc.apb2_pre = APBPrescaler::DIV2;
    rcc.mux.clk48sel = mux::Clk48sel::PLL1_Q;
    config.dma_interrupt_priority = BELOW_STEPS;
    config
}

/// Puts every interrupt that embassy uses below the step interrupt.
pub fn priorities() {
    use embassy_stm32::interrupt as irq;
    irq::USART3.set_priority(BELOW_STEPS);
    irq::OTG_FS.set_priority(BELOW_STEPS);
    irq::FLASH.set_priority(BELOW_STEPS);
    irq::TIM8_CC.set_priority(BELOW_STEPS);
    irq::TIM8_UP_TIM13.set_priority(BELOW_STEPS);
}

/// A halted core halts the step timers and the watchdog with it (RM0090 sections 38.16.4 and 38.16.5): a breakpoint must
/// not leave the DMA to play the ring again and again.
pub fn freeze_in_debug() {
    pac::DBGMCU.apb1fzr().modify(|w| {
        w.set_tim2(true);
        w.set_tim3(true);
        w.set_tim4(true);
        w.set_tim5(true);
        w.set_iwdg(true);
    });
    pac::DBGMCU.apb2fzr().modify(|w| w.set_tim1(true));
}
