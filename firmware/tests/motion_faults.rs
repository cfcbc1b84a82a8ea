//! Late software, late DMA, stops and emergencies at every turn: no step is ever wrong, missing or extra without being told.

mod motion_model;

use motion_model::{ALL, Bench, Mock};
use parfocal_firmware::motion::engine::SERVICE;
use parfocal_firmware::motion::lane::Lane;
use parfocal_firmware::motion::path::{Limits, Path};
use parfocal_firmware::motion::record::Pulse;
use parfocal_firmware::motion::record::SHORTEST;
use parfocal_firmware::motion::{Ending, Motion, MotionEvent};
use parfocal_protocol::message::{StopCause, Trust};
use parfocal_protocol::settings::{AxisSettings, Driver, Edges};
use parfocal_protocol::units::*;
use proptest::prelude::*;

const ONE: Limits = Limits { v: 1.0, a: 1.0, j: 1.0 };

/// A line of `n` steps with the top interval `interval`, ready to play on axis 0 (and `others` on the rest).
fn line(both: bool, tj: u64, ta: u64, tv: u64, counts: &[u32]) -> (Bench, u64, u64) {
    let mut bench = Bench::new();
    bench.run(30_000);
    let path = Path::of_durations(1.0, tj, ta, tv);
    let begin = bench.engine.laid(ALL) + 2_000;
    for (axis, n) in counts.iter().enumerate() {
        bench.engine.set_pulse(axis, Pulse { high: 20, setup: 17, both, inverted: false });
        let (path, scale) = (path.clone(), f64::from(*n));
        let lane = Lane { begin, path, scale, up: true, base: 0, offset: 0.0, limits: ONE, play: Default::default() };
        assert!(bench.engine.append(axis, &lane.phases()));
    }
    (bench, begin, path.ticks())
}

/// Steps of the same line without any fault.
fn planned(both: bool, tj: u64, ta: u64, tv: u64, counts: &[u32]) -> Vec<Vec<(u64, bool)>> {
    let (mut bench, _, ticks) = line(both, tj, ta, tv, counts);
    bench.run(ticks + 600_000);
    (0..counts.len()).map(|axis| bench.steps(axis, both)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Up to 80 µs late at the top rate: nothing is seen of it.
    #[test]
    fn a_late_step_interrupt_changes_nothing(
        delays in prop::collection::vec(0u64..6_700, 200),
        both in any::<bool>(),
    ) {
        let counts = [if both { 182_608 } else { 91_304 }];
        let (tj, ta, tv) = (500_000, 2_700_000, 500_000);
        let expected = planned(both, tj, ta, tv, &counts);
        let (mut bench, _, ticks) = line(both, tj, ta, tv, &counts);
        let end = bench.timers.tick() + ticks + 600_000;
        let mut due = bench.timers.tick();
        for delay in delays.iter().cycle() {
            // The interrupt comes on time; interrupts masked make it late.
            due += u64::from(SERVICE);
            let wait = (due + delay).saturating_sub(bench.timers.tick());
            bench.pass(wait);
            bench.engine.service(&mut bench.timers);
            if bench.timers.tick() > end { break }
        }
        prop_assert_eq!(bench.engine.gaps(), 0);
        prop_assert_eq!(&bench.steps(0, both), &expected[0]);
    }

    /// Interrupts masked for 2 ms at any moment, at any rate: a silent gap at most, and every step comes, in its order.
    #[test]
    fn two_milliseconds_without_interrupts_lose_no_step(
        interval in prop_oneof![Just(46u64), 46u64..500, 500u64..20_000],
        at in 0.0..1.0f64,
        both in any::<bool>(),
        share in 0.01..1.0f64,
    ) {
        let n = (8_000_000 / interval).clamp(50, 60_000) as u32;
        let whole = u64::from(n) * interval;
        let (tj, ta, tv) = (whole / 8, whole / 4, whole / 2);
        let counts = [if both { 2 * n } else { n }, ((f64::from(n) * share * 0.05) as u32).max(1)];
        let expected = planned(both, tj, ta, tv, &counts);
        let (mut bench, _, ticks) = line(both, tj, ta, tv, &counts);
        bench.run((ticks as f64 * at) as u64);
        bench.pass(168_000);
        bench.run(ticks + 1_200_000);
        for axis in 0..2 {
            let steps = bench.steps(axis, both);
            prop_assert_eq!(steps.len() as u32, counts[axis]);
            prop_assert_eq!(bench.engine.steps(axis), counts[axis] as i32);
            // Each step comes as planned, or later by the one gap.
            let late: Vec<i64> = steps.iter().zip(&expected[axis]).map(|(a, b)| a.0 as i64 - b.0 as i64).collect();
            prop_assert!(late.windows(2).all(|w| w[1] >= w[0]), "steps after the gap keep their distances");
            let mut values = late.clone();
            values.dedup();
            prop_assert!(values.len() == 1 || values.len() == 2 && values[0] == 0, "one gap at most: {:?}", values);
            prop_assert!(*values.last().unwrap() < 700_000);
        }
    }

    /// DMA up to just below the shortest record late: not one edge moves.
    #[test]
    fn dma_within_its_bound_changes_nothing(latency in 0u32..SHORTEST, both in any::<bool>()) {
        let counts = [if both { 60_000 } else { 30_000 }, 1_000];
        let (tj, ta, tv) = (200_000, 500_000, 480_000);
        let expected = planned(both, tj, ta, tv, &counts);
        let (mut bench, _, ticks) = line(both, tj, ta, tv, &counts);
        bench.timers.set_latency(latency);
        bench.run(ticks + 600_000);
        prop_assert_eq!(bench.engine.take_late(), None);
        for (axis, expected) in expected.iter().enumerate() {
            prop_assert_eq!(&bench.steps(axis, both), expected);
        }
    }
}

fn ready(edges: Edges) -> (Mock, Motion) {
    let (mut board, mut motion) = (Mock::new(), Motion::new());
    let s = AxisSettings {
        driver: Driver::Tmc2209,
        edges,
        steps_per_um: StepsPerMicrometre(100.0),
        speed: MicrometresPerSecond(5_000.0),
        acceleration: MicrometresPerSecond2(100_000.0),
        jerk: MicrometresPerSecond3(10_000_000.0),
        ..AxisSettings::default()
    };
    for axis in 0..4 {
        motion.configure(&mut board, Axis(axis), &s).unwrap();
    }
    (board, motion)
}

fn begin(board: &mut Mock, motion: &mut Motion) {
    let to = [Some(Nanometres(300_000)), Some(Nanometres(-123_450)), None, Some(Nanometres(50))];
    motion.move_to(board.now(), board, &to, None, Ending::Approach).unwrap();
}

/// All timers run dry together: the one that moved is told, not one that stood.
#[test]
fn a_long_stall_is_told_of_the_axis_that_moved() {
    for moved in 0..4u8 {
        let (mut board, mut motion) = ready(Edges::Rising);
        let mut to = [None; 4];
        to[usize::from(moved)] = Some(Nanometres(300_000));
        motion.move_to(board.now(), &mut board, &to, None, Ending::Approach).unwrap();
        board.run(&mut motion, 60, |_| false);
        board.bench.pass(840_000);
        board.bench.run(1_000_000);
        let events = board.run(&mut motion, 100, |_| false);
        let told = StopCause::Underrun { axis: Axis(moved) };
        assert!(
            matches!(events[..], [MotionEvent::Stopped { cause, .. }] if cause == told),
            "axis {moved} moved: {events:?}"
        );
    }
}

#[test]
fn a_long_stall_ends_in_a_flagged_stop() {
    for (at, edges) in [(20, Edges::Rising), (60, Edges::Both), (90, Edges::Both), (100, Edges::Rising)] {
        let (mut board, mut motion) = ready(edges);
        begin(&mut board, &mut motion);
        board.run(&mut motion, at, |_| false);
        board.bench.pass(840_000);
        board.bench.run(1_000_000);
        let events = board.run(&mut motion, 100, |_| false);
        assert!(
            matches!(events[..], [MotionEvent::Stopped { cause: StopCause::Underrun { .. }, .. }]),
            "{at}: {events:?}"
        );
        for axis in 0..2 {
            assert_eq!(motion.steps(&mut board)[axis].0, board.seen(axis, edges == Edges::Both, false), "{at}");
            assert_eq!(motion.status(&mut board, Axis(axis as u8)).trust, Trust::Lost);
        }
        // And it moves again, from where it is.
        board.bench.changes.clear();
        let from = motion.steps(&mut board)[0].0;
        motion
            .move_to(board.now(), &mut board, &[Some(Nanometres(0)), None, None, None], None, Ending::Approach)
            .unwrap();
        board.run(&mut motion, 2000, |e| matches!(e, MotionEvent::InPosition(_)));
        assert_eq!(motion.steps(&mut board)[0].0, 0);
        assert_eq!(board.seen(0, edges == Edges::Both, false), -from);
    }
}

#[test]
fn dma_beyond_its_bound_ends_in_a_flagged_stop() {
    let (mut board, mut motion) = ready(Edges::Rising);
    begin(&mut board, &mut motion);
    board.bench.timers.set_latency(400);
    let events =
        board.run(&mut motion, 2000, |e| matches!(e, MotionEvent::Stopped { .. } | MotionEvent::InPosition(_)));
    assert!(matches!(events[..], [MotionEvent::Stopped { cause: StopCause::Underrun { .. }, .. }]), "{events:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// DMA later than the bound, at random: what came out is what is told, or the axis is flagged and everything stops.
    #[test]
    fn dma_beyond_its_bound_is_never_silent(latency in SHORTEST..3_000u32, both in any::<bool>()) {
        let edges = if both { Edges::Both } else { Edges::Rising };
        let (mut board, mut motion) = ready(edges);
        begin(&mut board, &mut motion);
        board.bench.timers.set_latency(latency);
        let over = |e: &MotionEvent| matches!(e, MotionEvent::Stopped { .. } | MotionEvent::InPosition(_));
        let events = board.run(&mut motion, 2000, over);
        let stopped = matches!(events.last(), Some(MotionEvent::Stopped { cause: StopCause::Underrun { .. }, .. }));
        prop_assert!(stopped || matches!(events.last(), Some(MotionEvent::InPosition(_))), "{:?}", events);
        for axis in 0..4 {
            let (told, seen) = (motion.steps(&mut board)[axis].0, board.seen(axis, both, false));
            let lost = motion.status(&mut board, Axis(axis as u8)).trust == Trust::Lost;
            prop_assert!(told == seen || (lost && stopped), "axis {}: {} told, {} seen, {:?}", axis, told, seen, events);
        }
        // No runaway: nothing comes any more.
        let before = board.bench.changes.iter().filter(|c| c.step).count();
        board.run(&mut motion, 50, |_| false);
        prop_assert_eq!(board.bench.changes.iter().filter(|c| c.step).count(), before);
    }
}

/// A short move is stopped at every one of its edges, to the tick, and a tick before and behind.
#[test]
fn a_stop_at_every_edge_keeps_count() {
    let to = [Some(Nanometres(1_500)), Some(Nanometres(-700)), None, None];
    for both in [false, true] {
        let edges = if both { Edges::Both } else { Edges::Rising };
        let (mut board, mut motion) = ready(edges);
        motion.move_to(board.now(), &mut board, &to, None, Ending::Approach).unwrap();
        board.run(&mut motion, 200, |e| matches!(e, MotionEvent::InPosition(_)));
        let ticks: Vec<u64> = board.bench.changes.iter().filter(|c| c.step).map(|c| c.tick).collect();
        assert!(ticks.len() >= 220, "{} edges", ticks.len());
        for (i, tick) in ticks.into_iter().enumerate() {
            let (mut board, mut motion) = ready(edges);
            motion.move_to(board.now(), &mut board, &to, None, Ending::Approach).unwrap();
            let at = tick + i as u64 % 3 - 1;
            board.bench.run(at - at % u64::from(SERVICE));
            board.bench.pass(at - board.bench.timers.tick());
            motion.stop(board.now(), &mut board, StopCause::Asked);
            let over = |e: &MotionEvent| matches!(e, MotionEvent::Stopped { .. } | MotionEvent::InPosition(_));
            let events = board.run(&mut motion, 400, over);
            assert!(events.last().is_some_and(over), "edge {i}: it does not end");
            for axis in 0..4 {
                assert_eq!(motion.steps(&mut board)[axis].0, board.seen(axis, both, false), "edge {i}, axis {axis}");
            }
        }
    }
}

#[test]
fn a_stop_at_every_record_keeps_count() {
    for both in [false, true] {
        let edges = if both { Edges::Both } else { Edges::Rising };
        for k in 0..400 {
            let (mut board, mut motion) = ready(edges);
            begin(&mut board, &mut motion);
            board.bench.run(8_400 * 10);
            // A prime step: every phase of a record, and of the service, comes up.
            board.bench.run(8_400 * (k / 3));
            board.bench.pass(u64::from(k as u32 * 7919 % 8_400));
            let asked = board.bench.timers.tick();
            motion.stop(board.now(), &mut board, StopCause::Asked);
            let events = board.run(&mut motion, 400, |e| matches!(e, MotionEvent::Stopped { .. }));
            assert!(matches!(events[..], [MotionEvent::Stopped { cause: StopCause::Asked, .. }]), "{k} {events:?}");
            for axis in 0..4 {
                assert_eq!(motion.steps(&mut board)[axis].0, board.seen(axis, both, false), "stop {k}, axis {axis}");
            }
            // The first longer interval comes within 4 ms, where intervals are shorter than that by far.
            let steps = board.bench.steps(0, both);
            let after: Vec<u64> = steps.iter().map(|s| s.0).collect();
            if let Some(first) = after.windows(3).find(|w| w[1] > asked && w[2] - w[1] > w[1] - w[0])
                && first[1] - first[0] < 21_000
            {
                assert!(first[2] <= asked + 4 * 84_000, "stop {k}: slower only after {} µs", (first[2] - asked) / 84);
            }
        }
    }
}

#[test]
fn an_emergency_at_every_moment_keeps_count() {
    for both in [false, true] {
        let edges = if both { Edges::Both } else { Edges::Rising };
        for k in 0..600u64 {
            let (mut board, mut motion) = ready(edges);
            begin(&mut board, &mut motion);
            board.bench.run(8_400 * (20 + k / 2));
            board.bench.pass(k * 7919 % 8_400);
            motion.emergency(board.now(), &mut board);
            for axis in 0..4 {
                assert_eq!(motion.steps(&mut board)[axis].0, board.seen(axis, both, false), "{k}, axis {axis}");
            }
            motion.clear_emergency(board.now(), &mut board).unwrap();
            let before = motion.steps(&mut board);
            board.bench.changes.retain(|_| false);
            board.run(&mut motion, 3, |_| false);
            assert_eq!(motion.steps(&mut board), before);
        }
    }
}
