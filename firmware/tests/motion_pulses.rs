//! Every edge of whole moves against the exact path, in whole numbers.

mod motion_model;

use motion_model::exact::Exact;
use motion_model::{ALL, Bench};
use parfocal_firmware::motion::lane::Lane;
use parfocal_firmware::motion::limits::INTERVAL;
use parfocal_firmware::motion::path::{Limits, Path};
use parfocal_firmware::motion::record::Pulse;
use proptest::prelude::*;
use std::cmp::Ordering;

/// A path's durations and steps, and how STEP is driven.
#[derive(Clone, Debug)]
struct Case {
    tj: u64,
    ta: u64,
    tv: u64,
    steps: Vec<u32>,
    both: bool,
}

/// Plays one line on as many axes as there are counts; checks every edge of each.
fn check(case: &Case) {
    let Case { tj, ta, tv, both, .. } = *case;
    let mut bench = Bench::new();
    bench.run(30_000);
    let path = Path::of_durations(1.0, tj, ta, tv);
    let begin = bench.engine.laid(ALL) + 2_000;
    for (axis, n) in case.steps.iter().enumerate() {
        bench.engine.set_pulse(axis, Pulse { high: 20, setup: 17, both, inverted: false });
        let lane = Lane {
            begin,
            path: path.clone(),
            scale: f64::from(*n),
            up: true,
            base: 0,
            offset: 0.0,
            limits: Limits { v: 1.0, a: 1.0, j: 1.0 },
            play: Default::default(),
        };
        assert!(bench.engine.append(axis, &lane.phases()));
    }
    bench.run(path.ticks() + 600_000);
    assert_eq!(bench.engine.gaps(), 0);
    let exact = Exact { tj: tj.into(), ta: ta.into(), tv: tv.into() };
    assert_eq!(exact.ticks(), path.ticks().into());
    for (axis, n) in case.steps.iter().enumerate() {
        let steps = bench.steps(axis, both);
        assert_eq!(steps.len(), *n as usize, "count of axis {axis}");
        assert_eq!(bench.engine.steps(axis), *n as i32);
        assert!(!bench.engine.busy(axis));
        for (k, (tick, up)) in steps.iter().enumerate() {
            assert!(*up);
            let t = i128::from(*tick) - i128::from(begin);
            let k32 = k as u32;
            assert_ne!(
                exact.at(*n, t - 1, k32),
                Ordering::Greater,
                "axis {axis}: edge {k} comes more than a tick late"
            );
            assert_ne!(exact.at(*n, t + 1, k32), Ordering::Less, "axis {axis}: edge {k} comes more than a tick early");
        }
    }
}

/// Ticks of a path with that many steps whose fastest step comes `interval` ticks after the one before.
fn cases() -> impl Strategy<Value = Case> {
    let log = |low: f64, high: f64| (low.ln()..high.ln()).prop_map(f64::exp);
    (
        log(1.0, 300_000.0),
        log(f64::from(INTERVAL), 3e6),
        0.0..1.0f64,
        0.0..1.0f64,
        any::<bool>(),
        prop::collection::vec(0.0..1.0f64, 0..3),
    )
        .prop_map(|(n, interval, cruise, constant, both, others)| {
            let interval = interval.max(f64::from(INTERVAL)) * if both { 0.5 } else { 1.0 };
            // The fastest interval times the steps is the time at top speed that all of it would take.
            let whole = (n.ceil() * interval).max(1000.0);
            let ramp = whole * (1.0 - cruise);
            // An acceleration within the board's: from rest to the rate in no less than rate / 2·10⁷ s.
            let rate = 84e6 / interval;
            let ramp = ramp.max(rate / 2e7 * 84e6).max(9_000.0);
            let tj = (ramp / 2.0 * (1.0 - constant)).clamp(8_400.0, 2e9);
            let ta = (ramp - 2.0 * tj).max(0.0);
            let n = (n.ceil()).max((ramp / interval).ceil());
            let tv = (n * interval - ramp).max(0.0);
            let mut steps = vec![n as u32];
            steps.extend(others.iter().map(|o| ((n * o) as u32).max(1)));
            Case { tj: tj.ceil() as u64, ta: ta.ceil() as u64, tv: tv.ceil() as u64, steps, both }
        })
        // Keeps a test's time small; the rates of several axes at once within what DMA can do.
        .prop_filter("too long", |c| c.steps[0] < 400_000 && 4 * c.tj + 2 * c.ta + c.tv < 3_000_000_000)
        .prop_map(|mut c| {
            let whole = (2 * c.tj + c.ta + c.tv) as f64;
            let mut total = 0.0;
            c.steps.retain(|n| {
                let records = f64::from(*n) / whole * 84e6 / if c.both { 2.0 } else { 1.0 };
                total += records;
                total < 1.9e6
            });
            c
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]
    #[test]
    fn every_edge_lies_within_a_tick_of_the_exact_path(case in cases()) {
        check(&case);
    }
}

#[test]
fn the_top_rate_of_either_kind() {
    // 46 ticks a record: 1.826 million records a second, 3.65 million steps with both edges. Ramps at 2·10⁷ steps/s².
    check(&Case { tj: 840_000, ta: 7_000_000, tv: 3_000_000, steps: vec![252_900], both: false });
    let n = (2.0f64 * 840_000.0 + 15_000_000.0 + 3_000_000.0) / 23.0;
    check(&Case { tj: 840_000, ta: 15_000_000, tv: 3_000_000, steps: vec![n as u32], both: true });
}

/// From the far end of a stretch, where the acceleration is none, the search for an edge once stopped 20 ticks short.
#[test]
fn a_few_steps_of_two_axes_in_no_time() {
    check(&Case { tj: 20_113, ta: 0, tv: 3_628, steps: vec![5, 4], both: true });
}

#[test]
fn a_single_step_and_a_few() {
    for n in 1..12 {
        check(&Case { tj: 1_000_000, ta: 0, tv: 0, steps: vec![n], both: n % 2 == 0 });
        check(&Case { tj: 500_000_000, ta: 1, tv: 100_000, steps: vec![n], both: n % 2 == 1 });
    }
}

#[test]
fn what_it_takes_of_the_boards_memory() {
    use parfocal_firmware::motion::{Engine, Motion};
    assert!(size_of::<Engine>() < 42 * 1024, "{} bytes: four rings are 32 KiB of it", size_of::<Engine>());
    assert!(size_of::<Motion>() < 6 * 1024, "{} bytes", size_of::<Motion>());
}
