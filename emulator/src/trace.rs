//! What came out of one step timer: every edge of STEP and DIR, in ticks of 84 MHz.

use rigless::device::{DeviceContext, ErasedDevice, Level, RegisterFile, RequestChange};
use rigless::soc::RegisterSpec;
use rigless::soc::stm32f427::peripherals::tim::{Channel, Family, Tim};
use rigless::time::{EventId, VirtualNanos};
use std::sync::{Arc, Mutex};

/// The unit of a tick, Hz.
pub const TICK_HZ: u64 = 84_000_000;

/// A change of level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Ticks since the timers last got another clock.
    pub tick: u64,
    /// The level from here on.
    pub high: bool,
}

/// One axis' outputs.
#[derive(Debug, Default)]
pub struct Trace {
    /// Edges of channel 1.
    pub step: Vec<Edge>,
    /// Edges of channel 2.
    pub dir: Vec<Edge>,
    /// Updates of the timer, each the begin of a record.
    pub updates: Vec<u64>,
    /// How many of `step` had come when the board was last reset: its outputs let go, which ends a pulse, counted in.
    pub until_reset: Option<usize>,
    from: u64,
    levels: [bool; 2],
}

impl Trace {
    /// The tick in which an instant falls: the models round a tick's instant up to the next ns.
    pub fn tick(&self, at: VirtualNanos) -> u64 {
        (u128::from(at.0 - self.from) * u128::from(TICK_HZ) / 1_000_000_000) as u64
    }

    /// Ticks at which STEP rose.
    pub fn rises(&self) -> impl Iterator<Item = u64> {
        self.step.iter().filter(|e| e.high).map(|e| e.tick)
    }

    /// Steps made, rising edges counted by the direction in force, high being positive.
    pub fn position(&self) -> i64 {
        let mut dirs = self.dir.iter().peekable();
        let mut forward = false;
        self.rises().fold(0, |position, tick| {
            while let Some(dir) = dirs.next_if(|d| d.tick <= tick) {
                forward = dir.high;
            }
            position + if forward { 1 } else { -1 }
        })
    }

    /// The board is reset: its pins are let go (RM0090 section 8.3.1), and what was high falls.
    pub fn restarted(&mut self, at: VirtualNanos) {
        let tick = self.tick(at);
        for (high, edges) in self.levels.iter_mut().zip([&mut self.step, &mut self.dir]) {
            if std::mem::take(high) {
                edges.push(Edge { tick, high: false });
            }
        }
        self.until_reset = Some(self.step.len());
    }

    /// Forgets all edges: what follows is another experiment.
    pub fn clear_edges(&mut self) {
        self.until_reset = None;
        self.step.clear();
        self.dir.clear();
        self.updates.clear();
    }
}

/// A timer whose first two outputs are recorded.
#[derive(Debug)]
pub struct Recorded<F: Family> {
    timer: Tim<F>,
    trace: Arc<Mutex<Trace>>,
    updates: u64,
    /// Pulses seen on the trigger output.
    triggers: u64,
    /// The timers at the internal trigger inputs, ITR0 first.
    sources: &'static [&'static str],
}

/// The request output on which a timer's TRGO is told to the timers that hear it: none of the model's own.
const TRIGGER_OUTPUT: usize = 64;

impl<F: Family> Recorded<F> {
    /// Records `timer` into `trace`.
    pub fn new(timer: Tim<F>, trace: Arc<Mutex<Trace>>) -> Self {
        Self { timer, trace, updates: 0, triggers: 0, sources: &[] }
    }

    /// Hears the trigger outputs of other timers (RM0090 table 97).
    pub fn hearing(self, sources: &'static [&'static str]) -> Self {
        Self { sources, ..self }
    }
}

impl<F: Family> Recorded<F>
where
    Tim<F>: ErasedDevice,
{
    fn look(&mut self, registers: &RegisterFile, context: &mut DeviceContext<'_>) {
        let mut trace = self.trace.lock().expect("one thread at a time");
        let trace = &mut *trace;
        let tick = trace.tick(context.now());
        for (i, edges) in [&mut trace.step, &mut trace.dir].into_iter().enumerate() {
            let channel = Channel::new(i as u8 + 1).expect("channels 1 and 2 exist");
            let high = self.timer.output(channel, registers) == Some(Level::High);
            if high != trace.levels[i] {
                trace.levels[i] = high;
                edges.push(Edge { tick, high });
            }
        }
        let updates = self.timer.dma_requests().update;
        if updates != self.updates {
            self.updates = updates;
            trace.updates.push(tick);
        }
        let triggers = self.timer.trigger_output().1;
        if triggers != self.triggers {
            self.triggers = triggers;
            context.request(TRIGGER_OUTPUT, Level::High);
            context.request(TRIGGER_OUTPUT, Level::Low);
        }
    }
}

impl<F: Family> ErasedDevice for Recorded<F>
where
    Tim<F>: ErasedDevice,
{
    fn layout(&self) -> &'static [RegisterSpec] {
        ErasedDevice::layout(&self.timer)
    }
    fn read(&mut self, row: usize, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) -> Option<u64> {
        let value = ErasedDevice::read(&mut self.timer, row, registers, context);
        self.look(registers, context);
        value
    }
    fn write(&mut self, row: usize, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        ErasedDevice::write(&mut self.timer, row, value, registers, context);
        self.look(registers, context);
    }
    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        ErasedDevice::on_event(&mut self.timer, event, registers, context);
        self.look(registers, context);
    }
    fn on_request(&mut self, change: RequestChange, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if change.request == TRIGGER_OUTPUT {
            if let Some(input) = self.sources.iter().position(|s| *s == change.instance) {
                self.timer.drive_internal_trigger(input as u8, change.level, registers, context);
                self.look(registers, context);
            }
        } else {
            ErasedDevice::on_request(&mut self.timer, change, registers, context);
        }
    }
    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        ErasedDevice::on_clock(&mut self.timer, hz, registers, context);
        self.trace.lock().expect("one thread at a time").from = context.now().0;
    }
    fn poll(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        ErasedDevice::poll(&mut self.timer, registers, context);
        self.look(registers, context);
    }
    fn on_access(&mut self, token: u64, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        ErasedDevice::on_access(&mut self.timer, token, value, registers, context);
    }
    fn on_refused(&mut self, token: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        ErasedDevice::on_refused(&mut self.timer, token, registers, context);
    }
    fn reset(&mut self) {
        ErasedDevice::reset(&mut self.timer);
    }
    fn reset_line(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        ErasedDevice::reset_line(&mut self.timer, registers, context);
    }
}
