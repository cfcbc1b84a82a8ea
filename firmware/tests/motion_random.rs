//! Random requests, whatever they are: pulses as the driver wants them, counts as the pins say, moves where they were sent.

mod motion_model;

use motion_model::Mock;
use parfocal_firmware::motion::{Ending, Motion, MotionEvent};
use parfocal_protocol::message::{StopCause, Trust};
use parfocal_protocol::settings::{AxisSettings, Driver, Edges, Side};
use parfocal_protocol::units::*;
use proptest::prelude::*;

/// Pulse high, pulse low, DIR before and behind a step, ns: from the drivers' data sheets.
fn wants(driver: Driver) -> [u64; 3] {
    match driver {
        Driver::A4988 => [1000, 1000, 200],
        Driver::Drv8825 => [1900, 1900, 650],
        Driver::Tmc2209 => [100, 100, 20],
        Driver::External => [5000, 5000, 5000],
    }
}

/// Checks the levels of one axis from edge to edge.
fn check_pulses(board: &Mock, axis: usize, s: &AxisSettings) {
    let [high, low, dir] = wants(s.driver).map(|ns| (ns * 84).div_ceil(1000));
    let (mut rose, mut fell, mut turned) = (None::<u64>, None::<u64>, None::<u64>);
    for c in board.bench.changes.iter().filter(|c| c.axis == axis) {
        let since = |t: Option<u64>| t.map_or(u64::MAX, |t| c.tick - t);
        match (c.step, c.high) {
            (true, true) => {
                assert!(since(fell) >= low, "low for {} ticks", since(fell));
                assert!(since(turned) >= dir, "DIR {} ticks before a step", since(turned));
                rose = Some(c.tick);
            }
            (true, false) => {
                assert!(since(rose) >= high, "high for {} ticks", since(rose));
                if s.edges == Edges::Both {
                    assert!(since(turned) >= dir, "DIR {} ticks before a step", since(turned));
                }
                fell = Some(c.tick);
            }
            (false, _) => {
                assert!(since(rose) >= dir, "DIR {} ticks behind a step", since(rose));
                if s.edges == Edges::Both {
                    assert!(since(fell) >= dir, "DIR {} ticks behind a step", since(fell));
                }
                turned = Some(c.tick);
            }
        }
    }
}

#[derive(Clone, Copy, Debug)]
enum Wish {
    Move([Option<i32>; 4]),
    Jog(u8, f32),
    Vibrate(u8, i32),
    Hold,
    Resume,
    Stop,
    Wait(u64),
    Stall(u64),
}

fn wishes() -> impl Strategy<Value = Vec<Wish>> {
    let nm = || prop::option::of(-200_000i32..200_000);
    let one = prop_oneof![
        4 => [nm(), nm(), nm(), nm()].prop_map(Wish::Move),
        3 => (0u8..4, prop_oneof![Just(0.0f32), -1000.0f32..1000.0]).prop_map(|(a, v)| Wish::Jog(a, v)),
        1 => (0u8..4, 500i32..8_000).prop_map(|(a, nm)| Wish::Vibrate(a, nm)),
        1 => Just(Wish::Hold),
        1 => Just(Wish::Resume),
        1 => Just(Wish::Stop),
        6 => (1u64..400).prop_map(Wish::Wait),
        1 => (0u64..168_000).prop_map(Wish::Stall),
    ];
    prop::collection::vec(one, 1..25)
}

fn settings() -> impl Strategy<Value = AxisSettings> {
    (
        prop_oneof![Just(1.0f32), Just(10.0), Just(33.3), Just(80.0)],
        prop_oneof![Just(Driver::A4988), Just(Driver::Drv8825), Just(Driver::Tmc2209), Just(Driver::External)],
        any::<bool>(),
        any::<bool>(),
        0i32..4_000,
        prop_oneof![Just(None), Just(Some(Side::Low)), Just(Some(Side::High))],
        0.0f32..1.0,
    )
        .prop_map(|(scale, driver, both, inverted, backlash, approach, quick)| AxisSettings {
            steps_per_um: StepsPerMicrometre(scale),
            speed: MicrometresPerSecond(200.0 + 800.0 * quick),
            acceleration: MicrometresPerSecond2(2_000.0 + 60_000.0 * quick),
            jerk: MicrometresPerSecond3(100_000.0 + 10_000_000.0 * quick),
            driver,
            edges: if both { Edges::Both } else { Edges::Rising },
            inverted,
            backlash: Nanometres(backlash),
            approach,
            settling: Milliseconds(3),
            ..AxisSettings::default()
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]
    #[test]
    fn whatever_is_asked_for_the_count_is_exact(
        settings in [settings(), settings(), settings(), settings()],
        wishes in wishes(),
        last in [-100_000i32..100_000, -100_000..100_000, -100_000..100_000, -100_000..100_000],
    ) {
        let (mut board, mut motion) = (Mock::new(), Motion::new());
        for (axis, s) in settings.iter().enumerate() {
            motion.configure(&mut board, Axis(axis as u8), s).unwrap();
        }
        let count = |board: &mut Mock, motion: &Motion| {
            for (axis, s) in settings.iter().enumerate() {
                assert_eq!(motion.steps(board)[axis].0, board.seen(axis, s.edges == Edges::Both, s.inverted));
            }
        };
        for wish in wishes {
            let now = board.now();
            match wish {
                Wish::Move(to) => {
                    let _ = motion.move_to(now, &mut board, &to.map(|t| t.map(Nanometres)), None, Ending::Approach);
                }
                Wish::Jog(axis, v) => {
                    let _ = motion.jog(now, &mut board, Axis(axis), MicrometresPerSecond(v));
                }
                Wish::Vibrate(axis, nm) => {
                    let _ = motion.vibrate(now, &mut board, Axis(axis), Nanometres(nm), Hertz(4.0), 2);
                }
                Wish::Hold => motion.hold(now, &mut board),
                Wish::Resume => motion.resume(),
                Wish::Stop => motion.stop(now, &mut board, StopCause::Asked),
                Wish::Wait(ms) => { board.run(&mut motion, ms, |_| false); }
                Wish::Stall(ticks) => board.bench.pass(ticks),
            }
        }
        motion.resume();
        motion.stop(board.now(), &mut board, StopCause::Asked);
        for _ in 0..40 {
            if motion.in_position() { break }
            board.run(&mut motion, 100, |_| false);
        }
        prop_assert!(motion.in_position(), "it does not come to rest");
        count(&mut board, &motion);
        let to = last.map(|nm| Some(Nanometres(nm)));
        let id = motion.move_to(board.now(), &mut board, &to, None, Ending::Approach).unwrap();
        let events = board.run(&mut motion, 10_000, |e| matches!(e, MotionEvent::InPosition(i) if *i == id));
        prop_assert_eq!(events.last(), Some(&MotionEvent::InPosition(id)));
        count(&mut board, &motion);
        for (axis, s) in settings.iter().enumerate() {
            let status = motion.status(&mut board, Axis(axis as u8));
            let off = (status.position.0 - last[axis]).abs();
            prop_assert!(f64::from(off) <= 500.0 / f64::from(s.steps_per_um.0) + 1.0, "{} nm off", off);
            // Stalls in a row may add up to one that is too long.
            prop_assert!(matches!(status.trust, Trust::Unknown | Trust::Lost));
            check_pulses(&board, axis, s);
        }
    }
}
