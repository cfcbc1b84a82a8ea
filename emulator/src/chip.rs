//! The chip: which models answer where, behind which clock, and how they are wired to each other.

use crate::flash::Array;
use crate::random::Random;
use crate::serial::{FarEnd, Line};
use crate::trace::{Recorded, Trace};
use crate::usb::{self, Otg};
use crate::usb_host::Host;
use rigless::cpu::armv7m::Dwt;
use rigless::device::{ErasedDevice, Level, ResetCause};
use rigless::mcu::{Mcu, Operate};
use rigless::soc::stm32f427::generated::{dbg, rcc as rcc_registers};
use rigless::soc::stm32f427::peripherals::dma::{Dma, Wire};
use rigless::soc::stm32f427::peripherals::gpio::{Gpio, Pin};
use rigless::soc::stm32f427::peripherals::tim::{Advanced, Counter, General, Tim, UPDATE_REQUEST};
use rigless::soc::stm32f427::peripherals::usart::{Kind, RECEIVE_REQUEST, TRANSMIT_REQUEST, Usart};
use rigless::soc::stm32f427::peripherals::{dbg::Dbg, flash::Flash, iwdg::Iwdg, pwr::Pwr, rcc, rcc::Rcc};
use rigless::soc::stm32f427::{self, Stm32f427};
use rigless::soc::{Builder, Bus, Clock, Gate, Layout, Region, RegisterSpec, WriteModify};
use rigless::time::VirtualNanos;
use std::num::NonZeroU32;
use std::sync::{Arc, Mutex};

/// Frequency of the core once the firmware has set the clocks.
pub const CORE_HZ: u64 = 168_000_000;

/// The step timers, by axis (firmware/src/board/timers.rs).
pub const AXES: [&str; 4] = ["TIM2", "TIM3", "TIM4", "TIM1"];

/// Flash, RAM and the rest (RM0090 section 2.3). Stores to flash reach the flash interface.
static MEMORY: [Region; 4] = [
    Region::flash("flash", 0x0800_0000, 2 << 20).erased_to(0xff).programmed_by("FLASH"),
    Region::ram("ccm", 0x1000_0000, 64 << 10),
    Region::system("system", 0x1fff_0000, 32 << 10),
    Region::ram("sram", 0x2000_0000, 192 << 10),
];

/// Requests that reach DMA1 (RM0090 table 42): the update requests of the general timers, and USART3.
static DMA1_REQUESTS: [Wire; 6] = [
    Wire { instance: "TIM2", request: UPDATE_REQUEST, channel: 3, streams: &[1, 7] },
    Wire { instance: "TIM3", request: UPDATE_REQUEST, channel: 5, streams: &[2] },
    Wire { instance: "TIM4", request: UPDATE_REQUEST, channel: 2, streams: &[6] },
    Wire { instance: "TIM5", request: UPDATE_REQUEST, channel: 6, streams: &[0, 6] },
    Wire { instance: "USART3", request: RECEIVE_REQUEST, channel: 4, streams: &[1] },
    Wire { instance: "USART3", request: TRANSMIT_REQUEST, channel: 4, streams: &[3] },
];

/// Requests that reach DMA2 (RM0090 table 43).
static DMA2_REQUESTS: [Wire; 1] = [Wire { instance: "TIM1", request: UPDATE_REQUEST, channel: 6, streams: &[5] }];

const PORTS: [&str; 8] = ["GPIOA", "GPIOB", "GPIOC", "GPIOD", "GPIOE", "GPIOF", "GPIOG", "GPIOH"];

/// Instance, enable register and enable bit: an access to an instance whose clock is off is refused (RM0090 section 6.3.10 to 14).
const GATES: [(&str, &str, &str); 20] = [
    ("GPIOA", "AHB1ENR", "GPIOAEN"),
    ("GPIOB", "AHB1ENR", "GPIOBEN"),
    ("GPIOC", "AHB1ENR", "GPIOCEN"),
    ("GPIOD", "AHB1ENR", "GPIODEN"),
    ("GPIOE", "AHB1ENR", "GPIOEEN"),
    ("GPIOF", "AHB1ENR", "GPIOFEN"),
    ("GPIOG", "AHB1ENR", "GPIOGEN"),
    ("GPIOH", "AHB1ENR", "GPIOHEN"),
    ("DMA1", "AHB1ENR", "DMA1EN"),
    ("DMA2", "AHB1ENR", "DMA2EN"),
    ("OTG_FS", "AHB2ENR", "OTGFSEN"),
    ("RNG", "AHB2ENR", "RNGEN"),
    ("TIM2", "APB1ENR", "TIM2EN"),
    ("TIM3", "APB1ENR", "TIM3EN"),
    ("TIM4", "APB1ENR", "TIM4EN"),
    ("TIM5", "APB1ENR", "TIM5EN"),
    ("USART3", "APB1ENR", "USART3EN"),
    ("PWR", "APB1ENR", "PWREN"),
    ("TIM1", "APB2ENR", "TIM1EN"),
    ("TIM8", "APB2ENR", "TIM8EN"),
];

/// What lies outside the chip and is shared with whoever plays with it.
#[derive(Clone, Debug, Default)]
pub struct World {
    /// The USB host.
    pub usb: Arc<Mutex<Host>>,
    /// The far end of USART3.
    pub serial: Arc<Mutex<Line>>,
    /// What came out of the step timers, by axis.
    pub axes: [Arc<Mutex<Trace>>; 4],
    /// What came out of the camera's output: its first channel.
    pub camera: Arc<Mutex<Trace>>,
    /// What flash bank 2 holds: it stays when the power goes.
    pub flash: Arc<Mutex<Vec<u8>>>,
}

/// The chip.
pub struct Chip {
    bus: Bus,
    /// A model for each slot of the bus that has one; ports and clocks stand apart, because their own type is needed.
    models: Vec<Option<Box<dyn ErasedDevice + Send>>>,
    ports: Vec<(usize, Gpio)>,
    rcc: (usize, Rcc),
    world: World,
    /// What was last put on pins from outside: a reset does not change it.
    driven: Vec<((char, u8), Option<Level>)>,
}

impl std::fmt::Debug for Chip {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Chip")
    }
}

/// A register by its row, whatever the table: for reading a register file that is not ours.
#[derive(Clone, Copy, Debug)]
struct Row(usize);

impl Layout for Row {
    const REGISTERS: &'static [RegisterSpec] = &[];
    fn from_index(index: usize) -> Option<Self> {
        Some(Self(index))
    }
    fn index(self) -> usize {
        self.0
    }
}

/// The bus: rigless's tables of the STM32F427, with our USB, and the reset values, gates and clocks of what the firmware uses.
fn bus() -> Bus {
    let whole = Stm32f427::new().expect("rigless's own part assembles");
    let mut instances: Vec<_> = whole.bus().peripherals().copied().filter(|p| !p.name.starts_with("OTG_FS")).collect();
    instances.push(usb::PERIPHERAL);
    let mut builder = Bus::builder(stm32f427::CPU, &MEMORY, instances);
    // Reset values come from rigless's corrected table, register by register.
    for peripheral in whole.bus().peripherals() {
        let Some(registers) = whole.bus().registers(peripheral.name) else { continue };
        if peripheral.name.starts_with("OTG_FS") {
            continue;
        }
        for (row, spec) in peripheral.registers.iter().enumerate() {
            let corrected = registers.get(Row(row));
            if corrected != spec.reset {
                builder = builder.reset(peripheral.name, spec.name, corrected);
            }
        }
    }
    builder = timers(builder);
    for (instance, register, bit) in GATES {
        builder = builder.gate(instance, Gate::by("RCC", register, bit));
    }
    builder
        .write_modify("FLASH", "SR", WriteModify::OneToClear)
        .field("FLASH", "ACR", "LATENCY", stm32f427::peripherals::flash::LATENCY)
        .field("FLASH", "CR", "LOCK", stm32f427::peripherals::flash::LOCK)
        .field("FLASH", "CR", "STRT", stm32f427::peripherals::flash::STRT)
        .clocked_by("USART3", Clock::output("RCC", rcc::PCLK1))
        .clocked_by("DWT", Clock::output("RCC", rcc::HCLK))
        .clocked_by("FLASH", Clock::output("RCC", rcc::HCLK))
        .clocked_by("IWDG", Clock::output("RCC", rcc::IWDG_CLK))
        .reads_requests("DMA1")
        .reads_requests("DMA2")
        .reads_requests("RCC")
        .reads_requests("TIM5")
        .build()
        .expect("the tables name what exists")
}

fn timers(mut builder: Builder) -> Builder {
    for timer in ["TIM1", "TIM2", "TIM3", "TIM4", "TIM5", "TIM8"] {
        let clock = if matches!(timer, "TIM1" | "TIM8") { rcc::APB2_TIMERS } else { rcc::APB1_TIMERS };
        builder =
            builder.write_modify(timer, "SR", WriteModify::ZeroToClear).clocked_by(timer, Clock::output("RCC", clock));
    }
    builder
}

impl Chip {
    /// A chip fresh out of reset on a NUCLEO-F429ZI: 8 MHz at HSE, 3.3 V.
    pub fn new(world: &World) -> Self {
        let bus = bus();
        let slot = |name| bus.slot_of(name).expect("the bus has it");
        let ports = PORTS.map(|p| (slot(p), Gpio::default())).into();
        let rcc = (slot("RCC"), Rcc::new());
        let models = (0..bus.slots().len()).map(|_| None).collect();
        let mut chip = Self { bus, models, ports, rcc, world: world.clone(), driven: Vec::new() };
        chip.fresh();
        chip.put("RNG", Random::new(0x1eaf));
        chip.put("OTG_FS", Otg::new(world.usb.clone()));
        chip
    }

    /// Puts a new model wherever rigless has one: most of its models of this part know no other way back to their reset state.
    fn fresh(&mut self) {
        self.rcc.1 = Rcc::new();
        self.rcc.1.attach_crystals(8_000_000, 0);
        self.ports.iter_mut().for_each(|(_, port)| *port = Gpio::default());

        let world = self.world.clone();
        let hsi = rcc::HSI_HZ;
        let supply = NonZeroU32::new(3300).expect("not zero");
        let mut flash = Flash::with_clock(hsi);
        flash.set_supply(supply);
        let mut usart = Usart::with_clock(Kind::Usart, hsi);
        usart.attach(FarEnd(world.serial.clone()));
        self.put("PWR", Pwr::new());
        self.put("DBG", Dbg);
        self.put("FLASH", Array::new(flash, world.flash.clone()));
        self.put("DWT", Dwt::with_clock(hsi));
        self.put("IWDG", Iwdg::new());
        self.put("USART3", usart);
        self.put("DMA1", Dma::new(&DMA1_REQUESTS, &[], false));
        self.put("DMA2", Dma::new(&DMA2_REQUESTS, &[], true));
        self.put("TIM8", Tim::<Advanced>::with_clock(hsi, Counter::Narrow));
        // TIM5's internal triggers 0 to 2 (RM0090 table 97).
        let camera = Tim::<General>::with_clock(hsi, Counter::Wide);
        self.put("TIM5", Recorded::new(camera, world.camera.clone()).hearing(&["TIM2", "TIM3", "TIM4"]));
        for (axis, trace) in AXES.into_iter().zip(&world.axes) {
            match axis {
                "TIM1" => {
                    self.put(axis, Recorded::new(Tim::<Advanced>::with_clock(hsi, Counter::Narrow), trace.clone()));
                }
                "TIM2" => self.put(axis, Recorded::new(Tim::<General>::with_clock(hsi, Counter::Wide), trace.clone())),
                _ => self.put(axis, Recorded::new(Tim::<General>::with_clock(hsi, Counter::Narrow), trace.clone())),
            }
        }
    }

    fn put(&mut self, name: &'static str, model: impl ErasedDevice + Send + 'static) {
        let slot = self.bus.slot(name).expect("the bus has it");
        self.models[slot] = Some(Box::new(model));
    }

    /// Puts a level on a pin from outside, or lets go of it.
    pub fn drive(&mut self, at: VirtualNanos, port: char, pin: u8, level: Option<Level>) {
        self.driven.retain(|(other, _)| *other != (port, pin));
        self.driven.push(((port, pin), level));
        self.put_on_pin(at, port, pin, level);
    }

    fn put_on_pin(&mut self, at: VirtualNanos, port: char, pin: u8, level: Option<Level>) {
        let index = (port as usize).wrapping_sub('A' as usize);
        let Some((slot, gpio)) = self.ports.get_mut(index) else { panic!("no port {port}") };
        let pin = Pin::new(pin).expect("a port has 16 pins");
        let (registers, mut context) = self.bus.drive(at, *slot);
        gpio.drive(pin, level, registers, &mut context);
    }

    /// The level on a pin.
    pub fn level(&self, port: char, pin: u8) -> bool {
        let (slot, gpio) = &self.ports[port as usize - 'A' as usize];
        let pin = Pin::new(pin).expect("a port has 16 pins");
        gpio.level(pin, self.bus.slots()[*slot].registers()) == Level::High
    }
}

impl Mcu for Chip {
    fn bus(&self) -> &Bus {
        &self.bus
    }

    fn bus_mut(&mut self) -> &mut Bus {
        &mut self.bus
    }

    /// A system reset: everything as out of power-on but the reset flags and the debug component (RM0090 section 6.1.1). RAM and
    /// flash stay as they are.
    fn reset(&mut self, at: VirtualNanos, cause: ResetCause) {
        let flags = self.bus.slots()[self.rcc.0].registers().get(rcc_registers::Register::Csr);
        let debug = self.bus.slot_of("DBG").expect("the bus has it");
        let kept = [dbg::Register::DbgmcuCr, dbg::Register::DbgmcuApb1Fz, dbg::Register::DbgmcuApb2Fz]
            .map(|r| (r, self.bus.slots()[debug].registers().get(r)));
        let world = self.world.clone();
        for trace in world.axes.iter().chain([&world.camera]) {
            trace.lock().expect("one thread at a time").restarted(at);
        }
        self.reset_every_model();
        self.fresh();
        let registers = self.bus.slot_mut(self.rcc.0).registers_mut();
        self.rcc.1.restarted(cause, flags, registers);
        for (register, value) in kept {
            self.bus.slot_mut(debug).registers_mut().set(register, value);
        }
        for ((port, pin), level) in self.driven.clone() {
            self.put_on_pin(at, port, pin, level);
        }
    }

    fn poll(&mut self, now: VirtualNanos) {
        self.poll_every_model(now);
    }

    fn split(&mut self, slot: usize) -> (&mut Bus, Option<&mut dyn ErasedDevice>) {
        if slot == self.rcc.0 {
            return (&mut self.bus, Some(&mut self.rcc.1));
        }
        if let Some((_, port)) = self.ports.iter_mut().find(|p| p.0 == slot) {
            return (&mut self.bus, Some(port));
        }
        let model = self.models.get_mut(slot).and_then(|m| m.as_mut()).map(|m| &mut **m as &mut dyn ErasedDevice);
        (&mut self.bus, model)
    }
}
