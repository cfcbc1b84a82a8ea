//! The step interrupt: SysTick, every [`SERVICE`] ticks, above every other interrupt. It lets the engine top up its rings.

use super::clocks::CORE_HZ;
use super::timers::{StepHardware, stop_all};
use super::watchdog::{Part, check_in};
use core::cell::RefCell;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{DCB, DWT, SYST};
use cortex_m_rt::exception;
use critical_section::Mutex;
use parfocal_firmware::motion::engine::CLOCK_PER_TICK;
use parfocal_firmware::motion::{Engine, SERVICE, StepTimers};
use parfocal_protocol::units::{AXES, TICKS_PER_SECOND};
use static_cell::StaticCell;

const _: () = assert!(CORE_HZ as u64 == TICKS_PER_SECOND * CLOCK_PER_TICK as u64, "the cycle counter is the clock");

struct Pulses {
    engine: &'static mut Engine,
    hardware: StepHardware,
}

/// Shared by the step interrupt and the controller; a critical section keeps them apart.
static PULSES: Mutex<RefCell<Option<Pulses>>> = Mutex::new(RefCell::new(None));

/// Starts the timers, silent, and the step interrupt.
pub fn start(hardware: StepHardware, mut systick: SYST, mut dcb: DCB, mut dwt: DWT) {
    static ENGINE: StaticCell<Engine> = StaticCell::new();
    dcb.enable_trace();
    dwt.enable_cycle_counter();
    let engine = ENGINE.init_with(Engine::new);
    critical_section::with(|cs| {
        *PULSES.borrow_ref_mut(cs) = Some(Pulses { engine, hardware });
    });
    restart();
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(SERVICE * CLOCK_PER_TICK - 1);
    systick.clear_current();
    systick.enable_interrupt();
    systick.enable_counter();
}

/// Runs `f` on the engine while the step interrupt waits.
pub fn with<R>(f: impl FnOnce(&mut Engine) -> R) -> R {
    critical_section::with(|cs| match PULSES.borrow_ref_mut(cs).as_mut() {
        Some(pulses) => f(pulses.engine),
        None => panic!("pulses are used before they are started"),
    })
}

/// Starts the timers, silent, from slot 0 of their rings.
pub fn restart() {
    critical_section::with(|cs| {
        let mut pulses = PULSES.borrow_ref_mut(cs);
        let Some(Pulses { engine, hardware }) = pulses.as_mut() else { return };
        engine.start(crate::control::now(), hardware.clock());
        for axis in 0..AXES {
            // SAFETY: the engine lies in a static (a StaticCell), in SRAM, where memory.x puts all statics.
            unsafe { hardware.load(axis, engine.ring(axis)) };
        }
        hardware.run();
    });
}

/// Stops the timers at once and tells the engine what was played.
pub fn stop() {
    critical_section::with(|cs| {
        let mut pulses = PULSES.borrow_ref_mut(cs);
        let Some(Pulses { engine, hardware }) = pulses.as_mut() else { return };
        // First all stop, then each is asked where it stands.
        stop_all();
        for axis in 0..AXES {
            let (left, count) = hardware.freeze(axis);
            engine.halted(axis, left, count);
        }
    });
}

/// Stops the timers without looking left or right: for faults and panics.
pub fn force_inactive() {
    stop_all();
}

/// Whether steps of an axis can give camera pulses.
pub fn has_trigger(axis: usize) -> bool {
    super::camera::source(axis).is_some()
}

#[exception]
fn SysTick() {
    critical_section::with(|cs| {
        if let Some(Pulses { engine, hardware }) = PULSES.borrow_ref_mut(cs).as_mut() {
            engine.service(hardware);
        }
    });
    check_in(Part::Steps);
}
