extern crate std;

use super::*;
use embassy_futures::block_on;
use embedded_storage_async::nor_flash::{ErrorType, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use parfocal_protocol::settings::{AxisSettings, BoardSettings};
use parfocal_protocol::units::{Milliseconds, StepsPerMicrometre};
use std::vec::Vec;
use std::{format, vec};

const PAGE: usize = 512;
const PAGES: usize = 4;

/// Flash in RAM that loses power after a number of words written or pages erased.
#[derive(Clone)]
struct Flash {
    bytes: Vec<u8>,
    left: usize,
}

#[derive(Debug)]
struct PowerCut;

impl NorFlashError for PowerCut {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl ErrorType for Flash {
    type Error = PowerCut;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;
    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), PowerCut> {
        let offset = offset as usize;
        bytes.copy_from_slice(&self.bytes[offset..offset + bytes.len()]);
        Ok(())
    }
    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = PAGE;
    async fn erase(&mut self, from: u32, to: u32) -> Result<(), PowerCut> {
        for page in (from as usize..to as usize).step_by(PAGE) {
            // Power that goes while a page is erased leaves part of it as it was.
            let end = if self.left == 0 { PAGE / 3 } else { PAGE };
            self.bytes[page..page + end].fill(0xff);
            self.left = self.left.checked_sub(1).ok_or(PowerCut)?;
        }
        Ok(())
    }
    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), PowerCut> {
        for (i, word) in bytes.chunks(4).enumerate() {
            self.left = self.left.checked_sub(1).ok_or(PowerCut)?;
            for (old, new) in self.bytes[offset as usize + 4 * i..].iter_mut().zip(word) {
                *old &= new;
            }
        }
        Ok(())
    }
}

fn blank() -> Flash {
    Flash { bytes: vec![0xff; PAGE * PAGES], left: usize::MAX }
}

fn store(flash: Flash) -> Store<Flash> {
    Store::new(flash, 0..(PAGE * PAGES) as u32)
}

fn flash_of(store: Store<Flash>) -> Flash {
    store.map.destroy().0
}

fn axis(scale: u32) -> AxisSettings {
    AxisSettings { steps_per_um: StepsPerMicrometre(scale as f32), ..AxisSettings::default() }
}

#[test]
fn a_blank_flash_holds_nothing() {
    assert_eq!(block_on(store(blank()).load()), Kept::default());
}

#[test]
fn everything_comes_back_after_a_restart() {
    let mut s = store(blank());
    let board = BoardSettings { host_timeout: Milliseconds(700), ..BoardSettings::default() };
    let rest = [
        RestingPosition { steps: Steps(-123_456), known: true },
        RestingPosition::default(),
        RestingPosition::default(),
        RestingPosition { steps: Steps(7), known: false },
    ];
    for what in [Keep::Axis(2, axis(40)), Keep::Board(board), Keep::Position(Some(rest))] {
        block_on(s.keep(&what)).unwrap();
    }
    let kept = block_on(store(flash_of(s)).load());
    assert_eq!(kept, Kept { axes: [None, None, Some(axis(40)), None], board: Some(board), position: Some(rest) });
}

#[test]
fn a_voided_position_is_gone() {
    let mut s = store(blank());
    block_on(s.keep(&Keep::Position(Some(Default::default())))).unwrap();
    block_on(s.keep(&Keep::Position(None))).unwrap();
    assert_eq!(block_on(store(flash_of(s)).load()).position, None);
}

/// Power goes at every single write of a long run of savings, page changes included.
#[test]
fn a_power_cut_leaves_the_old_or_the_new_value() {
    let mut cuts = 0;
    let mut before = blank();
    for generation in 1..60 {
        let (old, new) = (generation - 1, generation);
        for left in 0.. {
            let mut s = store(Flash { left, ..before.clone() });
            let done = block_on(s.keep(&Keep::Axis(1, axis(new)))).is_ok();
            let mut s = store(Flash { left: usize::MAX, ..flash_of(s) });
            let found = block_on(s.load()).axes[1];
            let allowed = [(old > 0).then(|| axis(old)), Some(axis(new))];
            assert!(allowed.contains(&found), "generation {generation}, cut after {left} writes: {found:?}");
            if done {
                assert_eq!(found, Some(axis(new)));
                before = flash_of(s);
                break;
            }
            // After a cut the next saving works, whatever the cut left behind.
            block_on(s.keep(&Keep::Axis(1, axis(new + 1000)))).unwrap();
            assert_eq!(block_on(s.load()).axes[1], Some(axis(new + 1000)), "generation {generation}, cut at {left}");
            cuts += 1;
        }
    }
    assert!(cuts > 500, "{cuts} cuts are too few to mean anything");
}

/// Power goes at every single write while the resting place is voided and kept again, as before and after every motion: it is
/// the old one, none, or the new one, and after a voiding that was told done never the old one.
#[test]
fn a_power_cut_never_brings_back_a_place_that_was_left() {
    let place = |n: i32| [RestingPosition { steps: Steps(n), known: true }; parfocal_protocol::units::AXES];
    let mut cuts = 0;
    let mut before = blank();
    for n in 1..40 {
        for left in 0.. {
            let mut s = store(Flash { left, ..before.clone() });
            let voided = block_on(s.keep(&Keep::Position(None))).is_ok();
            let kept = voided && block_on(s.keep(&Keep::Position(Some(place(n))))).is_ok();
            let mut s = store(Flash { left: usize::MAX, ..flash_of(s) });
            let found = block_on(s.load()).position;
            let old = (n > 1).then(|| place(n - 1));
            let allowed = [if voided { None } else { old }, None, Some(place(n)).filter(|_| voided)];
            assert!(allowed.contains(&found), "{n}, cut after {left} writes, voided {voided}: {found:?}");
            if kept {
                assert_eq!(found, Some(place(n)));
                before = flash_of(s);
                break;
            }
            cuts += 1;
        }
    }
    assert!(cuts > 100, "{cuts} cuts are too few to mean anything");
}

#[test]
fn a_record_of_the_first_form_is_migrated() {
    let now = AxisSettings { steps_per_um: StepsPerMicrometre(7.5), idle_off: true, ..AxisSettings::default() };
    let old = forms::Axis0 {
        steps_per_um: now.steps_per_um,
        speed: now.speed,
        acceleration: now.acceleration,
        jerk: now.jerk,
        low: now.low,
        high: now.high,
        inverted: now.inverted,
        driver: now.driver,
        edges: now.edges,
        backlash: now.backlash,
        approach: now.approach,
        settling: now.settling,
        home: now.home,
        home_speed: now.home_speed,
        home_at: now.home_at,
        switches: now.switches,
        has_switches: now.has_switches,
        idle_off: now.idle_off,
    };
    let mut s = store(blank());
    let (mut record, mut buffer) = ([0; BUFFER], [0; BUFFER]);
    let n = 1 + postcard::to_slice(&old, &mut record[1..]).unwrap().len();
    block_on(s.map.store_item(&mut buffer, &1, &&record[..n])).unwrap();
    assert_eq!(block_on(s.load()).axes[1], Some(now));
}

#[test]
fn a_record_of_another_form_counts_as_not_there() {
    let mut s = store(blank());
    let record = format!("{}from the future", '\u{63}');
    let mut buffer = [0; BUFFER];
    block_on(s.map.store_item(&mut buffer, &0, &record.as_bytes())).unwrap();
    assert_eq!(block_on(s.load()).axes[0], None);
    // And it can be overwritten.
    block_on(s.keep(&Keep::Axis(0, axis(3)))).unwrap();
    assert_eq!(block_on(s.load()).axes[0], Some(axis(3)));
}

#[test]
fn garbage_is_never_taken_for_settings() {
    let mut state = 1u32;
    for _ in 0..200 {
        let mut flash = blank();
        for b in &mut flash.bytes {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *b = (state >> 24) as u8;
        }
        let mut s = store(flash);
        assert_eq!(block_on(s.load()), Kept::default());
        block_on(s.keep(&Keep::Axis(0, axis(5)))).unwrap();
        assert_eq!(block_on(s.load()).axes[0], Some(axis(5)));
    }
}
