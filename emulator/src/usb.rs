//! USB OTG FS in device role (RM0090 chapter 34), as far as embassy's driver uses it: registers, FIFOs, handshakes.
//!
//! Once in [`SLOT_NANOS`] the host on the other end ([`Host`]) makes one transaction.

use crate::usb_host::{DATA_IN, DATA_OUT, Handshake, Host, Stage, Transfer};
use rigless::device::{Device, DeviceContext, Level, RegisterFile};
use rigless::soc::{Access, Layout, Peripheral, ReadAction, RegisterSpec, Width, WriteModify};
use rigless::time::{EventId, VirtualNanos};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

/// Time between transactions: what 64 bytes take at full speed, with their handshakes.
const SLOT_NANOS: u64 = 50_000;

/// Endpoints in each direction.
const ENDPOINTS: usize = 4;

/// Registers that are not an endpoint's, by offset (table 206).
const COMMON: [u32; 33] = [
    0x000, 0x004, 0x008, 0x00c, 0x010, 0x014, 0x018, 0x01c, 0x020, 0x024, 0x028, 0x02c, 0x038, 0x03c, 0x040, 0x044,
    0x048, 0x04c, 0x050, 0x054, 0x100, 0x104, 0x108, 0x10c, 0x800, 0x804, 0x808, 0x810, 0x814, 0x818, 0x81c, 0x834,
    0xe00,
];
/// An endpoint's: DIEPCTL, DIEPINT, DIEPTSIZ, DTXFSTS, DOEPCTL, DOEPINT, DOEPTSIZ, and its FIFO.
const OF_ENDPOINT: usize = 8;
const REGISTERS: usize = COMMON.len() + ENDPOINTS * OF_ENDPOINT;

const GAHBCFG: u32 = 0x008;
const GRSTCTL: u32 = 0x010;
const GINTSTS: u32 = 0x014;
const GINTMSK: u32 = 0x018;
const GRXSTSR: u32 = 0x01c;
const GRXSTSP: u32 = 0x020;
const DIEPTXF0: u32 = 0x028;
const CID: u32 = 0x03c;
const DCTL: u32 = 0x804;
const DSTS: u32 = 0x808;
const DIEPMSK: u32 = 0x810;
const DOEPMSK: u32 = 0x814;
const DAINT: u32 = 0x818;
const DAINTMSK: u32 = 0x81c;
const DIEPEMPMSK: u32 = 0x834;

const USBRST: u32 = 1 << 12;
const ENUMDNE: u32 = 1 << 13;
/// DIEPINT.TXFE
const FIFO_EMPTY: u32 = 1 << 7;
/// The bits of DIEPCTL and DOEPCTL.
const ACTIVE: u32 = 1 << 15;
const NAKS: u32 = 1 << 17;
const STALL: u32 = 1 << 21;
const CLEAR_NAK: u32 = 1 << 26;
const SET_NAK: u32 = 1 << 27;
const DISABLE: u32 = 1 << 30;
const ENABLE: u32 = 1 << 31;

const fn offset(row: usize) -> u32 {
    if row < COMMON.len() {
        return COMMON[row];
    }
    let endpoint = ((row - COMMON.len()) / OF_ENDPOINT) as u32;
    match (row - COMMON.len()) % OF_ENDPOINT {
        0 => 0x900 + 0x20 * endpoint,
        1 => 0x908 + 0x20 * endpoint,
        2 => 0x910 + 0x20 * endpoint,
        3 => 0x918 + 0x20 * endpoint,
        4 => 0xb00 + 0x20 * endpoint,
        5 => 0xb08 + 0x20 * endpoint,
        6 => 0xb10 + 0x20 * endpoint,
        _ => 0x1000 * (endpoint + 1),
    }
}

static TABLE: [RegisterSpec; REGISTERS] = {
    let plain = RegisterSpec {
        name: "OTG",
        offset: 0,
        width: Width::W32,
        reset: 0,
        access: Access::ReadWrite,
        read: ReadAction::None,
        write: WriteModify::None,
        fields: &[],
    };
    let mut table = [plain; REGISTERS];
    let mut row = 0;
    while row < REGISTERS {
        table[row].offset = offset(row);
        row += 1;
    }
    table
};

/// Where the controller answers.
pub const PERIPHERAL: Peripheral =
    Peripheral { name: "OTG_FS", base: 0x5000_0000, size: 0x4_0000, interrupts: &[67], registers: &TABLE };

/// A row of the table.
#[derive(Clone, Copy, Debug)]
pub struct Row(usize);

impl Layout for Row {
    const REGISTERS: &'static [RegisterSpec] = &TABLE;
    fn from_index(index: usize) -> Option<Self> {
        (index < REGISTERS).then_some(Self(index))
    }
    fn index(self) -> usize {
        self.0
    }
}

fn row(at: u32) -> Row {
    Row((0..REGISTERS).find(|r| offset(*r) == at).expect("an offset of the table"))
}

fn get(registers: &RegisterFile, at: u32) -> u32 {
    registers.get(row(at)) as u32
}

/// What an endpoint's register means.
enum Of {
    InControl,
    InInterrupts,
    InFifoSpace,
    OutControl,
    OutInterrupts,
    Fifo,
    Other,
}

fn endpoint(at: u32) -> (usize, Of) {
    let number = (at as usize >> 5) & 7;
    match (at, at & 0x1f) {
        (0x900..0xb00, 0x00) => (number, Of::InControl),
        (0x900..0xb00, 0x08) => (number, Of::InInterrupts),
        (0x900..0xb00, 0x18) => (number, Of::InFifoSpace),
        (0xb00..0xd00, 0x00) => (number, Of::OutControl),
        (0xb00..0xd00, 0x08) => (number, Of::OutInterrupts),
        (0x1000.., _) => ((at as usize >> 12) - 1, Of::Fifo),
        _ => (number, Of::Other),
    }
}

/// One direction of an endpoint.
#[derive(Clone, Copy, Debug, Default)]
struct Half {
    control: u32,
    interrupts: u32,
}

impl Half {
    /// A write to its control register.
    fn write(&mut self, value: u32, number: usize) {
        let commands = CLEAR_NAK | SET_NAK | DISABLE | ENABLE | NAKS;
        let mut new = value & !commands | self.control & (ENABLE | NAKS);
        for (bit, set, clear) in [(CLEAR_NAK, 0, NAKS), (SET_NAK, NAKS, 0), (ENABLE, ENABLE, 0), (DISABLE, 0, ENABLE)] {
            if value & bit != 0 {
                new = new & !clear | set;
            }
        }
        // Endpoint 0 is always active.
        self.control = if number == 0 { new | ACTIVE } else { new };
    }
}

/// The controller.
#[derive(Debug)]
pub struct Otg {
    host: Arc<Mutex<Host>>,
    latched: u32,
    /// Status words and data that wait in the receive FIFO.
    received: VecDeque<(u32, Vec<u8>)>,
    /// Words of the entry popped last.
    words: VecDeque<u32>,
    fifos: [Vec<u8>; ENDPOINTS],
    inward: [Half; ENDPOINTS],
    outward: [Half; ENDPOINTS],
    ticking: bool,
}

impl Otg {
    /// A controller whose cable ends at `host`.
    pub fn new(host: Arc<Mutex<Host>>) -> Self {
        Self {
            host,
            latched: 0,
            received: VecDeque::new(),
            words: VecDeque::new(),
            fifos: Default::default(),
            inward: Default::default(),
            outward: Default::default(),
            ticking: false,
        }
    }

    fn endpoint_interrupts(&self, registers: &RegisterFile) -> u32 {
        let [inmask, outmask, empty] = [DIEPMSK, DOEPMSK, DIEPEMPMSK].map(|r| get(registers, r));
        (0..ENDPOINTS).fold(0, |all, e| {
            let fifo = if self.fifos[e].is_empty() && empty >> e & 1 == 1 { FIFO_EMPTY } else { 0 };
            let inward = self.inward[e].interrupts & inmask | fifo != 0;
            all | u32::from(inward) << e | u32::from(self.outward[e].interrupts & outmask != 0) << (16 + e)
        })
    }

    fn interrupts(&self, registers: &RegisterFile) -> u32 {
        let endpoints = self.endpoint_interrupts(registers) & get(registers, DAINTMSK);
        let waiting = u32::from(!self.received.is_empty()) << 4;
        self.latched | waiting | u32::from(endpoints & 0xffff != 0) << 18 | u32::from(endpoints >> 16 != 0) << 19
    }

    fn line(&self, registers: &RegisterFile, context: &mut DeviceContext<'_>) {
        let due = self.interrupts(registers) & get(registers, GINTMSK) != 0 && get(registers, GAHBCFG) & 1 != 0;
        context.interrupt(0, if due { Level::High } else { Level::Low });
    }

    fn fifo_words(registers: &RegisterFile, number: usize) -> u32 {
        get(registers, if number == 0 { DIEPTXF0 } else { 0x100 + 4 * number as u32 }) >> 16
    }

    fn setup(&mut self, packet: [u8; 8]) -> Handshake {
        for half in [&mut self.inward[0], &mut self.outward[0]] {
            half.control = (half.control | NAKS) & !STALL;
        }
        self.received.push_back((8 << 4 | 6 << 17, packet.to_vec()));
        self.received.push_back((4 << 17, vec![]));
        Handshake::Ack(vec![])
    }

    fn out(&mut self, number: usize, data: &[u8]) -> Handshake {
        let half = &mut self.outward[number];
        if half.control & STALL != 0 {
            return Handshake::Stall;
        }
        // embassy never enables endpoint 0, and arms the others again by clearing NAK alone.
        if half.control & NAKS != 0 || (number != 0 && half.control & ENABLE == 0) {
            return Handshake::Nak;
        }
        half.control |= NAKS;
        let number = number as u32;
        self.received.push_back((number | (data.len() as u32) << 4 | 2 << 17, data.to_vec()));
        self.received.push_back((number | 3 << 17, vec![]));
        Handshake::Ack(vec![])
    }

    fn input(&mut self, number: usize, registers: &mut RegisterFile) -> Handshake {
        let half = &mut self.inward[number];
        if half.control & STALL != 0 {
            return Handshake::Stall;
        }
        let size_register = 0x910 + 0x20 * number as u32;
        let size = (get(registers, size_register) & 0x7f) as usize;
        if half.control & NAKS != 0 || half.control & ENABLE == 0 || self.fifos[number].len() < size {
            return Handshake::Nak;
        }
        half.control &= !ENABLE;
        half.interrupts |= 1;
        registers.set(row(size_register), 0);
        let mut data = std::mem::take(&mut self.fifos[number]);
        data.truncate(size);
        Handshake::Ack(data)
    }

    /// One transaction of whatever the host wants next.
    fn transact(&mut self, registers: &mut RegisterFile) {
        let host = self.host.clone();
        let mut host = host.lock().expect("one thread at a time");
        if !host.attached {
            return;
        }
        match host.transfers.front().cloned() {
            // Connected: DCTL.SDIS is clear.
            Some(Transfer::Reset) if get(registers, DCTL) & 2 == 0 => {
                self.latched |= USBRST | ENUMDNE;
                // Full speed.
                registers.set(row(DSTS), 6);
                host.end(Some(vec![]));
            }
            Some(Transfer::Reset) => {}
            Some(Transfer::Control { setup, out }) => self.control(&mut host, setup, &out, registers),
            None => self.data(&mut host, registers),
        }
    }

    fn control(&mut self, host: &mut Host, setup: [u8; 8], out: &[u8], registers: &mut RegisterFile) {
        let length = usize::from(u16::from_le_bytes([setup[6], setup[7]]));
        let inward = setup[0] & 0x80 != 0;
        let handshake = match (host.stage, inward) {
            (Stage::Setup, _) => self.setup(setup),
            (Stage::Data, true) | (Stage::Status, false) => self.input(0, registers),
            (Stage::Data, false) => self.out(0, &out[host.sent..out.len().min(host.sent + 64)]),
            (Stage::Status, true) => self.out(0, &[]),
        };
        match (handshake, host.stage) {
            (Handshake::Nak, _) => {}
            (Handshake::Stall, _) => host.end(None),
            (_, Stage::Setup) => host.stage = if length == 0 { Stage::Status } else { Stage::Data },
            (Handshake::Ack(data), Stage::Data) => {
                let short = inward && data.len() < 64;
                host.received.extend(data);
                host.sent = (host.sent + 64).min(out.len());
                if short || host.received.len() + host.sent >= length {
                    host.stage = Stage::Status;
                }
            }
            (Handshake::Ack(_), Stage::Status) => {
                let answer = std::mem::take(&mut host.received);
                host.end(Some(answer));
            }
        }
    }

    /// The serial port's bytes, in turns.
    fn data(&mut self, host: &mut Host, registers: &mut RegisterFile) {
        host.turn = !host.turn;
        let packet = host.packet();
        if host.turn && !packet.is_empty() {
            if let Handshake::Ack(_) = self.out(DATA_OUT, &packet) {
                host.to_board.drain(..packet.len());
            }
        } else if let Handshake::Ack(data) = self.input(DATA_IN, registers) {
            host.from_board.extend(data);
        }
    }

    /// The next entry of the receive FIFO; its data can be read from the FIFO after.
    fn pop(&mut self) -> u32 {
        let (status, data) = self.received.pop_front().unwrap_or_default();
        self.words = data
            .chunks(4)
            .map(|chunk| {
                let mut word = [0; 4];
                word[..chunk.len()].copy_from_slice(chunk);
                u32::from_le_bytes(word)
            })
            .collect();
        match status >> 17 & 15 {
            4 => self.outward[0].interrupts |= 8,
            3 => self.outward[(status & 15) as usize].interrupts |= 1,
            _ => {}
        }
        status
    }

    fn flush(&mut self, command: u32) {
        if command & 1 << 4 != 0 {
            self.received.clear();
            self.words.clear();
        }
        if command & 1 << 5 != 0 {
            let which = (command >> 6 & 31) as usize;
            for (number, fifo) in self.fifos.iter_mut().enumerate() {
                if which == 16 || which == number {
                    fifo.clear();
                }
            }
        }
    }
}

impl Device for Otg {
    type Register = Row;

    fn read(&mut self, register: Row, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) -> Option<u64> {
        let at = offset(register.0);
        let (number, of) = endpoint(at);
        let value = match (at, of) {
            // The AHB is idle.
            (GRSTCTL, _) => 0x8000_0000,
            (GINTSTS, _) => self.interrupts(registers),
            (GRXSTSR, _) => self.received.front().map_or(0, |entry| entry.0),
            (GRXSTSP, _) => self.pop(),
            (CID, _) => 0x1200,
            (DAINT, _) => self.endpoint_interrupts(registers),
            (_, Of::InControl) => self.inward[number].control,
            (_, Of::InInterrupts) => {
                self.inward[number].interrupts | if self.fifos[number].is_empty() { FIFO_EMPTY } else { 0 }
            }
            (_, Of::InFifoSpace) => Self::fifo_words(registers, number) - self.fifos[number].len().div_ceil(4) as u32,
            (_, Of::OutControl) => self.outward[number].control,
            (_, Of::OutInterrupts) => self.outward[number].interrupts,
            (_, Of::Fifo) => self.words.pop_front().unwrap_or(0),
            _ => return None,
        };
        self.line(registers, context);
        Some(value.into())
    }

    fn write(&mut self, register: Row, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let (at, value) = (offset(register.0), value as u32);
        let (number, of) = endpoint(at);
        match (at, of) {
            (GRSTCTL, _) => self.flush(value),
            (GINTSTS, _) => self.latched &= !value,
            (_, Of::InControl) => {
                self.inward[number].write(value, number);
                // Setting NAK takes effect at once, and so does disabling.
                if value & SET_NAK != 0 {
                    self.inward[number].interrupts |= 1 << 6;
                }
                if value & DISABLE != 0 {
                    self.inward[number].interrupts |= 1 << 1;
                }
            }
            (_, Of::InInterrupts) => self.inward[number].interrupts &= !value,
            (_, Of::OutControl) => self.outward[number].write(value, number),
            (_, Of::OutInterrupts) => self.outward[number].interrupts &= !value,
            (_, Of::Fifo) => self.fifos[number].extend(value.to_le_bytes()),
            _ => {}
        }
        if !self.ticking {
            self.ticking = true;
            context.schedule(VirtualNanos(context.now().0 + SLOT_NANOS));
        }
        self.line(registers, context);
    }

    fn on_event(&mut self, _: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.transact(registers);
        context.schedule(VirtualNanos(context.now().0 + SLOT_NANOS));
        self.line(registers, context);
    }

    fn reset(&mut self) {
        *self = Self::new(self.host.clone());
    }
}
