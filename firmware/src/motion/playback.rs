//! The step timers and their DMA in software: plays the rings as the hardware does, for the simulator and for tests.

use super::engine::{CLOCK_PER_TICK, Engine, FIRST, StepTimers};
use super::record::{RING, Record};
use heapless::Deque;
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
    /// The axis whose records are counted for camera pulses.
    follows: usize,
    /// Ticks of camera pulses given.
    pulses: Deque<u64, 64>,
    /// Most ticks between a request and the record's arrival.
    latency: u32,
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
    /// Ticks until the request that stands is served.
    due: Option<u32>,
    /// Draws the latencies.
    random: u32,
    /// Updates so far: record `n` begins with the one that makes `n + 1` of them.
    updates: u32,
    /// The record that a camera pulse waits for.
    armed: Option<u32>,
    /// Whether it began, and when, until that is taken note of.
    fired: bool,
    pulse: Option<u64>,
}

impl Playback {
    /// Streams at slot 0, timers about to start.
    pub fn new(engine: &Engine) -> Self {
        let axes = core::array::from_fn(|axis| {
            let ring = engine.ring(axis);
            Timer {
                active: Record::pulse(FIRST, ring[0].ccr1, ring[0].ccr2),
                preload: ring[0],
                fifo: ring[1],
                fetched: 1,
                count: 0,
                step: false,
                dir: false,
                wake: false,
                due: None,
                random: 1 + axis as u32,
                updates: 0,
                armed: None,
                fired: false,
                pulse: None,
            }
        });
        Self { axes, tick: 0, follows: 0, pulses: Deque::new(), latency: 0 }
    }

    /// From now on every record arrives up to so many ticks after it was asked for, drawn evenly. A request that
    /// still stands at the next update is lost, as on the chip: the record before is played again.
    pub fn set_latency(&mut self, ticks: u32) {
        self.latency = ticks;
    }

    /// Ticks since the start.
    pub fn tick(&self) -> u64 {
        self.tick
    }

    /// Lets `ticks` pass and tells what changed, axis by axis.
    pub fn play(&mut self, engine: &Engine, ticks: u64, mut changed: impl FnMut(Change)) {
        let end = self.tick + ticks;
        let (start, latency) = (self.tick, self.latency);
        for (axis, timer) in self.axes.iter_mut().enumerate() {
            let told = |tick, step, high| changed(Change { tick, axis, step, high });
            timer.play(engine.ring(axis), latency, start, end, told);
            if let Some(tick) = timer.pulse.take() {
                if self.pulses.is_full() {
                    self.pulses.pop_front();
                }
                let _ = self.pulses.push_back(tick);
            }
        }
        self.tick = end;
    }

    /// The next camera pulse given, ticks since the start; the oldest of 64 kept.
    pub fn camera_pulse(&mut self) -> Option<u64> {
        self.pulses.pop_front()
    }

    /// Whether an axis' timer stands.
    pub fn stands(&self, axis: usize) -> bool {
        self.axes.get(axis).is_some_and(|t| t.active.arr == 0)
    }
}

impl Timer {
    fn play(
        &mut self,
        ring: &[Record; RING],
        latency: u32,
        mut now: u64,
        end: u64,
        mut changed: impl FnMut(u64, bool, bool),
    ) {
        loop {
            if core::mem::take(&mut self.wake) {
                self.update(latency, now);
            }
            if self.due == Some(0) {
                self.serve(ring);
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
            let stands = self.active.arr == 0;
            if now >= end || (stands && self.due.is_none()) {
                return;
            }
            let period = self.active.arr + 1;
            let next = if self.count < self.active.ccr1 { self.active.ccr1.min(period) } else { period };
            let mut step = end - now;
            if !stands {
                step = step.min(u64::from(next - self.count));
            }
            if let Some(due) = &mut self.due {
                step = step.min(u64::from(*due));
                *due -= step as u32;
            }
            now += step;
            if !stands {
                self.count += step as u32;
                if self.count == period {
                    self.update(latency, now);
                }
            }
        }
    }

    /// The next record plays, and another is asked for.
    fn update(&mut self, latency: u32, now: u64) {
        self.updates = self.updates.wrapping_add(1);
        if self.armed.is_some_and(|record| record.wrapping_add(1) == self.updates) {
            self.armed = None;
            self.fired = true;
            self.pulse = Some(now);
        }
        self.count = 0;
        self.active = self.preload;
        // Numerical Recipes' quick generator: any spread will do.
        self.random = self.random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        self.due.get_or_insert((self.random >> 8) % (latency + 1));
    }

    /// DMA transfers a record.
    fn serve(&mut self, ring: &[Record; RING]) {
        self.due = None;
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

    fn count(&mut self, axis: usize) -> Option<u32> {
        self.axes.get(axis).map(|t| t.count)
    }

    fn follow(&mut self, axis: usize, _: u32, _: u32) -> bool {
        self.follows = axis;
        axis < AXES
    }

    fn arm(&mut self, record: u32) -> bool {
        let Some(timer) = self.axes.get_mut(self.follows) else { return false };
        if (record.wrapping_add(1).wrapping_sub(timer.updates) as i32) < 2 {
            return false;
        }
        (timer.armed, timer.fired) = (Some(record), false);
        true
    }

    fn fired(&mut self) -> bool {
        self.axes.get(self.follows).is_some_and(|t| t.fired)
    }

    fn disarm(&mut self) {
        if let Some(timer) = self.axes.get_mut(self.follows) {
            (timer.armed, timer.fired) = (None, false);
        }
    }

    fn clock(&mut self) -> u32 {
        (self.tick * u64::from(CLOCK_PER_TICK)) as u32
    }
}
