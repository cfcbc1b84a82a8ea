//! Edges against the exact path.

mod motion_model;

use motion_model::{ALL, Bench};
use parfocal_firmware::motion::path::{Limits, Path, count, phase};
use parfocal_firmware::motion::track::Pulse;

fn play(n: f64, limits: Limits, both: bool) -> (Path, u64, Vec<(u64, bool)>) {
    let mut bench = Bench::new();
    bench.engine.set_pulse(0, Pulse { high: 20, setup: 20, both, inverted: false });
    bench.run(100_000);
    let path = Path::rest_to_rest(1.0, limits).unwrap();
    let mut begin = bench.engine.laid(ALL) + 1000;
    let start = begin;
    let mut before = 0.0;
    for (i, s) in path.stretches().iter().enumerate() {
        let last = i + 1 == path.stretches().len();
        let behind = count(s.end * n, last);
        if let Some(p) = phase(s, n, 0.0, begin, before, behind, true) {
            assert!(bench.engine.append(0, &[p]));
        }
        before = behind;
        begin += s.ticks;
    }
    bench.run(path.ticks() + 600_000);
    assert_eq!(bench.engine.gaps(), 0);
    assert_eq!(bench.engine.steps(0), n as i32);
    let steps = bench.steps(0, both);
    assert_eq!(steps.len(), n as usize);
    (path, start, steps)
}

#[test]
fn probe() {
    for (n, v, a, j, both) in [
        (1000.0, 10_000.0, 100_000.0, 10_000_000.0, false),
        (200_000.0, 400_000.0, 4_000_000.0, 400_000_000.0, false),
        (800_000.0, 1_826_000.0, 20_000_000.0, 4_000_000_000.0, false),
        (800_001.0, 3_652_000.0, 20_000_000.0, 4_000_000_000.0, true),
        (7.0, 100.0, 1000.0, 10_000.0, false),
    ] {
        let t = 84e6;
        let limits = Limits { v: v / t / n, a: a / t / t / n, j: j / t / t / t / n };
        let (path, start, steps) = play(n, limits, both);
        let mut worst: f64 = 0.0;
        for (k, (tick, up)) in steps.iter().enumerate() {
            assert!(up);
            // Edge k lies where the path passes k + 1/2: bracket it.
            let at = |tick: u64| path.state(tick - start).p * n - (k as f64 + 0.5);
            let s = path.state(tick - start);
            worst = worst.max((at(*tick) / (s.v * n)).abs());
        }
        println!("{n} steps: worst {worst} ticks, path {} ms", path.ticks() / 84_000);
    }
}
