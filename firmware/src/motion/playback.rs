//! The step timers and their DMA in software: plays the rings as the hardware does, for the simulator and for tests.

use super::engine::{CLOCK_PER_TICK, Engine, StepTimers};
use super::record::{RING, Record};
use parfocal_protocol::units::AXES;

/// What an output did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// Ticks since the timers started.
    pub tick: u64,
    /// Which axis.
    pub axis: usize,
    /// STEP, or else DIR.
    pub step: bool,
    /// Its new level.
    pub high: bool,
}

/// Four timers with their streams.
#[derive(Debug)]
pub struct Playback {
    axes: [Timer; AXES],
    tick: u64,
}

#[derive(Clone, Copy, Debug)]
struct Timer {
    active: Record,
    preload: Record,
    fifo: Record,
    /// Records transferred to the preload registers, modulo the ring.
    fetched: usize,
    count: u32,
    step: bool,
    dir: bool,
    wake: bool,
}

impl Playback {
    /// Ticks for which each timer is silent before record 0.
    pub const FIRST: u32 = 168;

    /// Streams at slot 0, timers about to start.
    pub fn new(engine: &Engine) -> Self {
        let axes = core::array::from_fn(|axis| {
            let ring = engine.ring(axis);
            Timer {
                active: Record::hold(Self::FIRST, false, 0),
                preload: ring[0],
                fifo: ring[1],
                fetched: 1,
                count: 0,
                step: false,
                dir: false,
                wake: false,
            }
        });
        Self { axes, tick: 0 }
    }

    /// Ticks since the start.
    pub fn tick(&self) -> u64 {
        self.tick
    }

    /// Lets `ticks` pass and tells what changed, axis by axis.
    pub fn play(&mut self, engine: &Engine, ticks: u64, mut changed: impl FnMut(Change)) {
        let end = self.tick + ticks;
        for (axis, timer) in self.axes.iter_mut().enumerate() {
            timer
                .play(engine.ring(axis), self.tick, end, |tick, step, high| changed(Change { tick, axis, step, high }));
        }
        self.tick = end;
    }

    /// CNT of an axis.
    pub fn count(&self, axis: usize) -> u32 {
        self.axes.get(axis).map_or(0, |t| t.count)
    }

    /// Whether an axis' timer stands.
    pub fn stands(&self, axis: usize) -> bool {
        self.axes.get(axis).is_some_and(|t| t.active.arr == 0)
    }
}

impl Timer {
    fn play(&mut self, ring: &[Record; RING], mut now: u64, end: u64, mut changed: impl FnMut(u64, bool, bool)) {
        loop {
            if core::mem::take(&mut self.wake) {
                self.update(ring);
            }
            let high = self.count < self.active.ccr1;
            if high != self.step {
                self.step = high;
                changed(now, true, high);
            }
            let dir = self.count < self.active.ccr2;
            if dir != self.dir {
                self.dir = dir;
                changed(now, false, dir);
            }
            if now >= end || self.active.arr == 0 {
                return;
            }
            let period = self.active.arr + 1;
            let next = if self.count < self.active.ccr1 { self.active.ccr1.min(period) } else { period };
            let step = u64::from(next - self.count).min(end - now);
            now += step;
            self.count += step as u32;
            if self.count == period {
                self.update(ring);
            }
        }
    }

    fn update(&mut self, ring: &[Record; RING]) {
        self.count = 0;
        self.active = self.preload;
        self.preload = self.fifo;
        self.fetched = (self.fetched + 1) % RING;
        self.fifo = ring[self.fetched];
    }
}

impl StepTimers for Playback {
    fn left(&mut self, axis: usize) -> u32 {
        self.axes.get(axis).map_or(0, |t| (RING - t.fetched) as u32 * 4)
    }

    fn wake(&mut self, axis: usize) {
        if let Some(timer) = self.axes.get_mut(axis) {
            timer.wake = true;
        }
    }

    fn clock(&mut self) -> u32 {
        (self.tick * u64::from(CLOCK_PER_TICK)) as u32
    }
}
