//! The link on a bad cable: bytes dropped, flipped, doubled and reordered, the board reset or unplugged. Every command
//! is carried out once or fails with an error; none twice, none lost silently.

use parfocal::link::transport::Transport;
use parfocal::link::{Link, LinkError, LinkOptions};
use parfocal_protocol::message::{MotionId, Request, Response, Role, Session};
use parfocal_protocol::units::{AXES, HostTime, Nanometres};
use parfocal_simulator::model::RigModel;
use parfocal_simulator::rig::Rig;
use proptest::prelude::*;
use std::io;
use std::sync::{Arc, Mutex};

/// A small generator of its own (splitmix64), so that faults repeat with their seed.
struct Faults {
    state: u64,
    /// Of 1000 bytes this many are hit.
    rate: u64,
}

impl Faults {
    fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.state ^ (self.state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn damage(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out: Vec<u8> = Vec::new();
        for byte in bytes {
            if self.next() % 1000 >= self.rate {
                out.push(*byte);
                continue;
            }
            match self.next() % 4 {
                0 => {}
                1 => out.push(byte ^ (1 << (self.next() % 8))),
                2 => out.extend([*byte, *byte]),
                _ => {
                    out.push(*byte);
                    let n = out.len();
                    if n > 1 {
                        out.swap(n - 1, n - 2);
                    }
                }
            }
        }
        // Now and then a whole packet comes twice.
        if self.next() % 1000 < self.rate { [out.clone(), out].concat() } else { out }
    }
}

#[derive(Clone)]
struct BadCable {
    rig: Arc<Mutex<Rig>>,
    faults: Arc<Mutex<Faults>>,
    unplugged_until: Arc<Mutex<u64>>,
}

impl BadCable {
    fn new(seed: u64, rate: u64) -> Self {
        Self {
            rig: Arc::new(Mutex::new(Rig::new(RigModel::new(seed)))),
            faults: Arc::new(Mutex::new(Faults { state: seed, rate })),
            unplugged_until: Arc::new(Mutex::new(0)),
        }
    }

    fn unplug_for(&self, micros: u64) {
        let mut rig = self.rig.lock().unwrap();
        *self.unplugged_until.lock().unwrap() = rig.now() + micros;
        rig.board_mut(0).unwrap().plug(false);
    }

    fn is_unplugged(&self) -> bool {
        self.rig.lock().unwrap().now() < *self.unplugged_until.lock().unwrap()
    }
}

impl Transport for BadCable {
    fn name(&self) -> String {
        "bad cable".into()
    }

    fn read(&mut self, buffer: &mut [u8], deadline: HostTime) -> io::Result<usize> {
        if self.is_unplugged() {
            self.rig.lock().unwrap().advance(deadline.0);
            return Err(io::ErrorKind::NotConnected.into());
        }
        let mut raw = vec![0; buffer.len() / 4];
        let n = self.rig.lock().unwrap().receive(0, &mut raw, deadline.0);
        let damaged = self.faults.lock().unwrap().damage(&raw[..n]);
        buffer[..damaged.len()].copy_from_slice(&damaged);
        Ok(damaged.len())
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        if self.is_unplugged() {
            return Err(io::ErrorKind::NotConnected.into());
        }
        let damaged = self.faults.lock().unwrap().damage(bytes);
        self.rig.lock().unwrap().send(0, &damaged);
        Ok(())
    }

    fn now(&self) -> HostTime {
        HostTime(self.rig.lock().unwrap().now())
    }

    fn reconnect(&mut self) -> io::Result<()> {
        if self.is_unplugged() {
            return Err(io::ErrorKind::NotConnected.into());
        }
        self.rig.lock().unwrap().board_mut(0).unwrap().plug(true);
        Ok(())
    }
}

fn open(cable: &BadCable) -> Result<Link, LinkError> {
    Link::open(Box::new(cable.clone()), Session(77), Role::Control, LinkOptions::default())
}

fn step(to: i32) -> Request {
    let mut targets = [None; AXES];
    targets[0] = Some(Nanometres(to));
    Request::Move { to: targets, speed: None }
}

fn latest_motion(link: &mut Link) -> Option<MotionId> {
    // The status itself may be lost: ask until one comes.
    (0..50).find_map(|_| match link.request(Request::Status) {
        Ok(Response::Status(status)) => Some(status.motion),
        _ => None,
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_command_is_carried_out_once_or_fails(seed in any::<u64>(), rate in 0u64..40) {
        let cable = BadCable::new(seed, rate);
        let Ok(mut link) = open(&cable) else { return Ok(()) };
        let before = latest_motion(&mut link);
        let (mut told, mut failed) = (Vec::new(), 0u32);
        for k in 1..=12 {
            match link.request(step(k * 1000)) {
                Ok(Response::Moving { motion }) => told.push(motion),
                Ok(other) => prop_assert!(false, "a move answered with {other:?}"),
                Err(_) => failed += 1,
            }
            // Let it end, so that the queue has room.
            let until = HostTime(link.now().0 + 300_000);
            while link.event(until).ok().flatten().is_some() {}
        }
        prop_assert!(told.windows(2).all(|w| w[0] < w[1]), "told twice: {told:?}");
        let (Some(before), Some(after)) = (before, latest_motion(&mut link)) else { return Ok(()) };
        let done = after.0 - before.0;
        // Every move that was answered was done; those that failed were done once or not at all.
        prop_assert!(done >= told.len() as u32 && done <= told.len() as u32 + failed, "{done} done, {} told, {failed} failed", told.len());
        prop_assert!(rate > 0 || failed == 0);
    }
}

#[test]
fn a_pulled_cable_that_comes_back_loses_and_repeats_nothing() {
    let cable = BadCable::new(5, 0);
    let mut link = open(&cable).unwrap();
    for k in 1..=5 {
        cable.unplug_for(400_000);
        let Response::Moving { motion } = link.request(step(k * 500)).unwrap() else { panic!("a move is begun") };
        assert_eq!(motion, MotionId(k as u32));
        let until = HostTime(link.now().0 + 500_000);
        while link.event(until).unwrap().is_some() {}
    }
}

#[test]
fn a_cable_that_stays_away_is_an_error_that_says_so_and_the_board_stops_by_itself() {
    let cable = BadCable::new(6, 0);
    let mut link = open(&cable).unwrap();
    link.request(step(8_000_000)).unwrap();
    cable.unplug_for(60_000_000);
    let error = link.request(Request::Status).unwrap_err();
    assert!(matches!(error, LinkError::Unplugged { .. }), "{error}");
    let mut rig = cable.rig.lock().unwrap();
    let later = rig.now() + 1_000_000;
    rig.advance(later);
    assert!(!rig.board_mut(0).unwrap().is_busy(), "the host is lost for longer than its timeout: the axes rest");
    drop(rig);
    *cable.unplugged_until.lock().unwrap() = 0;
    let mut again = {
        cable.rig.lock().unwrap().board_mut(0).unwrap().plug(true);
        Link::open(Box::new(cable.clone()), Session(78), Role::Control, LinkOptions::default()).unwrap()
    };
    assert_eq!(again.hello().last_stop, Some(parfocal_protocol::message::StopCause::HostLost));
    let Response::Status(status) = again.request(Request::Status).unwrap() else { panic!("a status") };
    assert!(
        status.in_position
            && status.axes[0].position > Nanometres(0)
            && status.axes[0].position < Nanometres(8_000_000)
    );
}

#[test]
fn one_session_controls_and_another_may_only_stop() {
    let cable = BadCable::new(7, 0);
    let mut link = open(&cable).unwrap();
    link.request(step(5_000_000)).unwrap();
    // The same wire serves both here; the board tells sessions apart by their numbers.
    let mut watcher = Link::open(Box::new(cable.clone()), Session(99), Role::Watch, LinkOptions::default()).unwrap();
    assert!(matches!(watcher.request(step(0)), Err(LinkError::NotInControl { .. })));
    let how = parfocal_protocol::message::Stop::Decelerate;
    assert!(matches!(watcher.request(Request::Stop { how }), Ok(Response::Done)));
}
