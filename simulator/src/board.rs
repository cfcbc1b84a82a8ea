//! A virtual controller board: the real firmware on virtual hardware, its link, and the stages on its axes.

use crate::hardware::{Driver, Hardware};
use crate::mechanics::Mechanics;
use crate::model::{BEYOND_NM, BoardModel};
use parfocal_firmware::controller::{Controller, Link};
use parfocal_firmware::port::{Port, Received, encode_message, encode_stranger};
use parfocal_firmware::ports::{Identity, Kept, RestingPosition};
use parfocal_protocol::message::{FromBoard, Label, ResetCause};
use parfocal_protocol::units::{AXES, BoardTime, Micrometres, Nanometres};
use std::collections::VecDeque;

/// How long the past of the carriages is remembered, µs: longer than any camera's latency.
const PAST_US: u64 = 3_000_000;

/// Bytes on their way, each packet with the time at which it arrives.
type Wire = VecDeque<(u64, Vec<u8>)>;

/// A virtual board.
pub struct VirtualBoard {
    controller: Controller<Hardware>,
    model: BoardModel,
    port: Port,
    link_us: u64,
    inbound: Wire,
    outbound: Wire,
    stages: Vec<Mechanics>,
    past: VecDeque<(u64, [f64; AXES])>,
    lived: u64,
    plugged: bool,
}

impl VirtualBoard {
    /// Switches board `number` on.
    pub fn new(number: usize, model: &BoardModel, link_us: u64, seed: u64) -> Self {
        let mut kept = Kept::default();
        let mut resting = [RestingPosition::default(); AXES];
        for (i, axis) in model.axes.iter().enumerate().take(AXES) {
            kept.axes[i] = Some(axis.settings);
            let at = axis.at.nanometres().unwrap_or_default();
            resting[i] = RestingPosition { steps: axis.settings.steps_per_um.steps(at), known: true };
        }
        kept.position = Some(resting);
        let start = board_time(model, 0);
        let drivers = std::array::from_fn(|i| {
            let settings = model.axes.get(i).map(|axis| axis.settings).unwrap_or_default();
            Driver::new(settings.edges, settings.inverted, resting[i].steps)
        });
        let controller = Controller::new(identity(number, model, seed), &kept, Hardware::new(start, drivers));
        let stages = model.axes.iter().map(|axis| Mechanics::new(axis.stage, axis.at)).collect();
        let mut board = Self {
            controller,
            model: model.clone(),
            port: Port::new(),
            link_us,
            inbound: Wire::new(),
            outbound: Wire::new(),
            stages,
            past: VecDeque::new(),
            lived: 0,
            plugged: true,
        };
        board.remember(0);
        board
    }

    /// Its firmware, for tests that look behind the protocol.
    pub fn controller_mut(&mut self) -> &mut Controller<Hardware> {
        &mut self.controller
    }

    /// Pulls or plugs the cable. What is on its way is lost.
    pub fn plug(&mut self, plugged: bool) {
        self.plugged = plugged;
        self.inbound.clear();
        self.outbound.clear();
    }

    /// Whether something is under way that wants short steps.
    pub fn is_busy(&self) -> bool {
        self.controller.is_busy() || !self.inbound.is_empty() || !self.outbound.is_empty()
    }

    /// Bytes towards the board.
    pub fn send(&mut self, now: u64, bytes: &[u8]) {
        if self.plugged {
            self.inbound.push_back((now + self.link_us, bytes.to_vec()));
        }
    }

    /// Bytes that have come from the board by `now`.
    pub fn receive(&mut self, now: u64, buffer: &mut [u8]) -> usize {
        let mut n = 0;
        while let Some((due, packet)) = self.outbound.front_mut() {
            if *due > now || n == buffer.len() {
                break;
            }
            let part = packet.len().min(buffer.len() - n);
            buffer[n..n + part].copy_from_slice(&packet[..part]);
            packet.drain(..part);
            n += part;
            if packet.is_empty() {
                self.outbound.pop_front();
            }
        }
        n
    }

    /// Lives until `now`: pulses play, bytes arrive, the firmware decides, the stages follow.
    pub fn live(&mut self, now: u64) {
        let time = board_time(&self.model, now);
        self.controller.board_mut().play(time);
        self.press_switches();
        while self.inbound.front().is_some_and(|(due, _)| *due <= now) {
            let Some((_, packet)) = self.inbound.pop_front() else { break };
            for byte in packet {
                self.take(now, byte);
            }
        }
        loop {
            while let Some(event) = self.controller.poll(time) {
                self.put(now, &event);
            }
            // Thoughts take no time here.
            if !self.controller.is_thinking() {
                break;
            }
        }
        let dt = now - self.lived;
        self.lived = now;
        for i in 0..self.stages.len() {
            let motor = self.motor(i);
            self.stages[i].follow(motor, dt);
        }
        self.remember(now);
    }

    /// Where a carriage was at a time.
    pub fn carriage(&self, axis: usize, at: u64) -> Micrometres {
        let after = self.past.partition_point(|(t, _)| *t < at);
        let Some(&(t1, new)) = self.past.get(after).or(self.past.back()) else { return Micrometres(0.0) };
        let Some(&(t0, old)) = after.checked_sub(1).and_then(|i| self.past.get(i)) else {
            return Micrometres(new[axis]);
        };
        let share = if t1 > t0 { ((at - t0) as f64 / (t1 - t0) as f64).min(1.0) } else { 1.0 };
        Micrometres(old[axis] + (new[axis] - old[axis]) * share)
    }

    /// Limit switches, normally closed, at both ends of every axis' travel.
    fn press_switches(&mut self) {
        let hardware = self.controller.board_mut();
        for (i, axis) in self.model.axes.iter().enumerate().take(AXES) {
            let s = &axis.settings;
            let end = |at: Nanometres, beyond: i32| s.steps_per_um.steps(Nanometres(at.0.saturating_add(beyond)));
            let motor = hardware.motor(i);
            hardware.inputs_mut().low_switch[i] = motor <= end(s.low, -BEYOND_NM);
            hardware.inputs_mut().high_switch[i] = motor >= end(s.high, BEYOND_NM);
        }
    }

    /// Where a motor stands, by the steps that its driver saw.
    pub fn motor(&mut self, axis: usize) -> Micrometres {
        let Some(model) = self.model.axes.get(axis) else { return Micrometres(0.0) };
        let scale = f64::from(model.settings.steps_per_um.0);
        Micrometres(f64::from(self.controller.board_mut().motor(axis).0) / scale)
    }

    fn remember(&mut self, now: u64) {
        let at = std::array::from_fn(|i| self.stages.get(i).map_or(0.0, |s| s.position().0));
        self.past.push_back((now, at));
        while self.past.front().is_some_and(|(t, _)| t + PAST_US < now) {
            self.past.pop_front();
        }
    }

    fn take(&mut self, now: u64, byte: u8) {
        let time = board_time(&self.model, now);
        match self.port.push(byte) {
            Some(Received::Request(request)) => {
                let reply = self.controller.handle(time, Link(0), &request);
                self.put(now, &reply);
            }
            Some(Received::Stranger(_)) => {
                let (frame, n) = encode_stranger();
                self.outbound.push_back((now + self.link_us, frame[..n].to_vec()));
            }
            None => {}
        }
    }

    fn put(&mut self, now: u64, message: &FromBoard) {
        if self.plugged {
            let (frame, n) = encode_message(message);
            self.outbound.push_back((now + self.link_us, frame[..n].to_vec()));
        }
    }
}

fn identity(number: usize, model: &BoardModel, seed: u64) -> Identity {
    let mut unique_id = *b"PF-sim-board";
    unique_id[11] = b'1' + number as u8;
    Identity {
        board: Label::new("simulated"),
        git: Label::new("same as host"),
        unique_id,
        boot: (seed as u32) ^ 0x5eed_0000,
        reset: ResetCause::Power,
        axes: model.axes.len().min(AXES) as u8,
        can_save: true,
    }
}

fn board_time(model: &BoardModel, now: u64) -> BoardTime {
    BoardTime(model.clock_offset_us + (now as f64 * (1.0 + model.clock_ppm * 1e-6)) as u64)
}
