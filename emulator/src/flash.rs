//! Flash that keeps what is written: rigless's model of the interface, and the array behind it (RM0090 section 3.6).

use rigless::device::{DeviceContext, ErasedDevice, Level, RegisterFile, RequestChange};
use rigless::soc::stm32f427::generated::flash::{Register, cr, sr};
use rigless::soc::stm32f427::peripherals::flash::Flash;
use rigless::soc::{Layout, RegisterSpec, Width};
use rigless::time::{EventId, VirtualNanos};
use std::sync::{Arc, Mutex};

/// Where the array begins.
const BASE: u64 = 0x0800_0000;
/// Bytes of a bank.
const BANK: u64 = 1 << 20;
/// Where bank 2 begins.
pub const BANK_2: u64 = BASE + BANK;
/// Time to program a word of 32 bits (DS9405 table 48, typical).
const WORD_NANOS: u64 = 16_000;
/// The interrupt's position.
const FLASH: usize = 0;

/// The interface with its array.
#[derive(Debug)]
pub struct Array {
    interface: Flash,
    /// Bank 2 as it stands: programming clears bits only.
    bank2: Arc<Mutex<Vec<u8>>>,
    /// When the word that is being programmed is done.
    programming: Option<EventId>,
    erasing: bool,
}

impl Array {
    /// An array that holds what `bank2` does; nothing there is an erased one.
    pub fn new(interface: Flash, bank2: Arc<Mutex<Vec<u8>>>) -> Self {
        bank2.lock().expect("one thread at a time").resize(BANK as usize, 0xff);
        Self { interface, bank2, programming: None, erasing: false }
    }

    fn put(&mut self, address: u64, value: u32, context: &mut DeviceContext<'_>) {
        let Some(at) = address.checked_sub(BASE + BANK).filter(|a| *a + 4 <= BANK) else { return };
        let mut bank2 = self.bank2.lock().expect("one thread at a time");
        bank2[at as usize..at as usize + 4].copy_from_slice(&value.to_le_bytes());
        context.program(address, Width::W32, value.into(), 0);
    }

    fn word(&self, address: u64) -> u32 {
        let at = (address - BASE - BANK) as usize;
        let bank2 = self.bank2.lock().expect("one thread at a time");
        u32::from_le_bytes(bank2[at..at + 4].try_into().expect("four bytes"))
    }

    /// The first address and the length of the sector that CR names, if it lies in bank 2 (table 6).
    fn sector(registers: &RegisterFile) -> Option<(u64, u64)> {
        let number = cr::SNB.get(registers.get(Register::Cr)).checked_sub(16)?;
        let kib = |k: u64| k * 1024;
        let (at, length) = match number {
            0..4 => (kib(16) * number, kib(16)),
            4 => (kib(64), kib(64)),
            5..12 => (kib(128) * (number - 4), kib(128)),
            _ => return None,
        };
        Some((BASE + BANK + at, length))
    }

    /// Drives the interrupt by the flags: the interface does not know of words programmed.
    fn line(registers: &RegisterFile, context: &mut DeviceContext<'_>) {
        let (status, control) = (registers.get(Register::Sr), registers.get(Register::Cr));
        let due = sr::EOP.is_set(status) && cr::EOPIE.is_set(control);
        context.interrupt(FLASH, if due { Level::High } else { Level::Low });
    }
}

impl ErasedDevice for Array {
    fn layout(&self) -> &'static [RegisterSpec] {
        ErasedDevice::layout(&self.interface)
    }
    fn read(&mut self, row: usize, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) -> Option<u64> {
        ErasedDevice::read(&mut self.interface, row, registers, context)
    }
    fn peek(&self, row: usize, registers: &RegisterFile, now: VirtualNanos) -> Option<u64> {
        ErasedDevice::peek(&self.interface, row, registers, now)
    }
    fn write(&mut self, row: usize, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        ErasedDevice::write(&mut self.interface, row, value, registers, context);
        match Register::from_index(row) {
            Some(Register::Cr) => self.erasing |= cr::SER.is_set(value) && value & 1 << 16 != 0,
            Some(Register::Sr) => Self::line(registers, context),
            _ => {}
        }
    }
    fn write_region(
        &mut self,
        address: u64,
        width: Width,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> bool {
        let control = registers.get(Register::Cr);
        let allowed = cr::PG.is_set(control) && !cr::LOCK.is_set(control);
        if !allowed || width != Width::W32 || address < BASE + BANK {
            context.tell("CR", "a store to flash without PG, of another width than 32 bits, or into bank 1");
            return true;
        }
        let new = self.word(address) & value as u32;
        self.put(address, new, context);
        registers.set(Register::Sr, sr::BSY.set(registers.get(Register::Sr), 1));
        self.programming = Some(context.schedule(VirtualNanos(context.now().0 + WORD_NANOS)));
        true
    }
    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if self.programming == Some(event) {
            self.programming = None;
            let status = sr::BSY.set(registers.get(Register::Sr), 0);
            let done = cr::EOPIE.is_set(registers.get(Register::Cr));
            registers.set(Register::Sr, sr::EOP.set(status, done.into()));
            Self::line(registers, context);
            return;
        }
        ErasedDevice::on_event(&mut self.interface, event, registers, context);
        if self.erasing && !sr::BSY.is_set(registers.get(Register::Sr)) {
            self.erasing = false;
            if let Some((from, length)) = Self::sector(registers) {
                for address in (from..from + length).step_by(4) {
                    self.put(address, u32::MAX, context);
                }
            }
        }
    }
    fn on_request(&mut self, change: RequestChange, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        ErasedDevice::on_request(&mut self.interface, change, registers, context);
    }
    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        ErasedDevice::on_clock(&mut self.interface, hz, registers, context);
    }
    fn poll(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        ErasedDevice::poll(&mut self.interface, registers, context);
    }
    fn on_access(&mut self, _: u64, _: u64, _: &mut RegisterFile, _: &mut DeviceContext<'_>) {}
    fn on_refused(&mut self, _: u64, _: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        context.tell("SR", "a word could not be put into the array");
    }
    fn reset(&mut self) {
        ErasedDevice::reset(&mut self.interface);
        (self.programming, self.erasing) = (None, false);
    }
}
