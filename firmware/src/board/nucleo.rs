//! Which pin is what on the NUCLEO-F429ZI, and the start of everything. The table for people: docs/wiring.md.

use super::io::{Switches, enable, switch};
use super::timers::StepHardware;
use super::{Irqs, Nucleo, clocks, pulses, serial, start, store, usb, watchdog};
use crate::control;
use embassy_executor::Spawner;
use embassy_stm32::rng::Rng;
use parfocal_firmware::controller::Controller;
use parfocal_firmware::ports::Kept;
use static_cell::StaticCell;

/// Starts the board and runs it for ever.
pub async fn run(spawner: Spawner) -> ! {
    let reset = start::cause();
    let p = embassy_stm32::init(clocks::config());
    clocks::priorities();
    clocks::freeze_in_debug();
    spawner.spawn(watchdog::watch(p.IWDG).expect("spawned once"));

    let boot = Rng::new(p.RNG, Irqs).next_u32();
    let identity = start::identity(boot, reset);
    let mut kept = Kept::default();
    if identity.can_save {
        let mut settings = store::Settings::new(p.FLASH);
        kept = settings.load().await;
        spawner.spawn(store::run(settings).expect("spawned once"));
    }

    StepHardware::claim(p.TIM2, p.DMA1_CH7, p.PA5, p.PB3);
    StepHardware::claim(p.TIM3, p.DMA1_CH2, p.PC6, p.PC7);
    StepHardware::claim(p.TIM4, p.DMA1_CH6, p.PD12, p.PD13);
    StepHardware::claim(p.TIM1, p.DMA2_CH5, p.PE9, p.PE11);
    StepHardware::claim_camera(p.TIM5, p.PA0);
    // SAFETY: the core's own peripherals, which embassy leaves alone but for the NVIC, SCB and its delay: taken once, here.
    let core = unsafe { cortex_m::Peripherals::steal() };
    pulses::start(StepHardware::all_claimed(), core.SYST, core.DCB, core.DWT);

    let hardware = Nucleo {
        switches: Switches {
            low: [switch(p.PE7), switch(p.PE10), switch(p.PE13), switch(p.PE15)],
            high: [switch(p.PE8), switch(p.PE12), switch(p.PE14), switch(p.PF11)],
            emergency: switch(p.PG9),
        },
        enables: [enable(p.PF12), enable(p.PF13), enable(p.PF14), enable(p.PF15)],
        can_save: identity.can_save,
    };
    // In one place for good: a task would keep a copy for every hand it passes through.
    static CONTROLLER: StaticCell<Controller<Nucleo>> = StaticCell::new();
    let controller = CONTROLLER.init_with(|| Controller::new(identity, &kept, hardware));

    let port = serial::Port { usart: p.USART3, tx: p.PD8, rx: p.PD9, tx_dma: p.DMA1_CH3, rx_dma: p.DMA1_CH1 };
    spawner.spawn(serial::run(port).expect("spawned once"));
    usb::start(spawner, usb::Port { otg: p.USB_OTG_FS, minus: p.PA11, plus: p.PA12 });
    control::run(controller).await
}
