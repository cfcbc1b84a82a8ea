//! Whatever a host says, a scan neither panics nor goes on for ever.

use parfocal_firmware::autofocus::{Ask, Scan};
use parfocal_protocol::autofocus::{FrameFault, Mode, ScanId, ScanParameters, ScanRefusal, Strategy, Subject};
use parfocal_protocol::units::{Axis, FocusValue, MicrometresPerSecond, Milliseconds, Nanometres};

/// Numbers that anyone can draw again.
struct Draw(u64);

impl Draw {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }

    fn one<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len() as u64) as usize]
    }

    /// Mostly near, sometimes at the ends of what a number can hold.
    fn place(&mut self) -> Nanometres {
        let near = self.below(400_001) as i32 - 200_000;
        Nanometres(self.one(&[near, near, near, near / 10, 0, i32::MIN, i32::MAX]))
    }

    fn value(&mut self) -> Result<FocusValue, FrameFault> {
        let some = self.below(1_000) as f64;
        let value =
            self.one(&[some, some, some, -some, 1.0, 0.0, -0.0, f64::NAN, f64::INFINITY, f64::MIN, f64::MAX, 1e-310]);
        let fault = self.one(&[FrameFault::Blank, FrameFault::Saturated, FrameFault::Stale, FrameFault::NoFrame]);
        if self.below(20) == 0 { Err(fault) } else { Ok(FocusValue(value)) }
    }
}

fn parameters(draw: &mut Draw) -> ScanParameters {
    // Some that are refused, most that are not.
    let length = |draw: &mut Draw, good: &[i32]| {
        if draw.below(20) == 0 { draw.one(&[1, 2, 7, i32::MAX, 0, -5, i32::MIN]) } else { draw.one(good) }
    };
    let side = |draw: &mut Draw| {
        if draw.below(20) == 0 { draw.place().0 } else { 1 + draw.below(200_000) as i32 }
    };
    ScanParameters {
        scan: ScanId(1),
        axis: Axis(2),
        strategy: draw.one(&[Strategy::Climb, Strategy::Mixed, Strategy::Scan]),
        mode: draw.one(&[Mode::Step, Mode::Sweep]),
        subject: draw.one(&[Subject::Peak, Subject::PhaseObject]),
        low: Nanometres(side(draw).saturating_neg()),
        high: Nanometres(side(draw)),
        sample_step: Nanometres(length(draw, &[500, 1_000, 2_000, 3_000])),
        trap: Nanometres(length(draw, &[3_000, 10_000, 30_000])),
        probe: Nanometres(length(draw, &[3_000, 5_000])),
        speed: MicrometresPerSecond(draw.one(&[0.0, 100.0])),
        sample_timeout: Milliseconds(1_000),
        verify: draw.below(2) == 0,
    }
}

/// Answers that fit, and `strange` of a hundred that do not: other places, no values, moves that were never asked for.
fn play(seed: u64, strange: u64) -> bool {
    let mut draw = Draw(seed);
    let p = parameters(&mut draw);
    let z0 = [Nanometres(0), Nanometres(0), p.low, p.high, draw.place()][draw.below(5) as usize];
    let Ok((mut scan, mut ask)) = Scan::begin(&p, z0) else { return false };
    let mut at = z0;
    for _ in 0..3_000 {
        if draw.below(100) < strange {
            ask = match draw.below(6) {
                0 => scan.arrived(draw.place()),
                1 if draw.below(200) == 0 => scan.abort(ScanRefusal::SamplesStopped),
                _ => scan.sample(draw.place(), draw.value()),
            };
        }
        ask = match ask {
            Ask::Sample { z } => scan.sample(z, draw.value()),
            Ask::Go { z } => scan.arrived(z),
            Ask::Sweep { to } => {
                at = Nanometres(at.0.saturating_add((i64::from(to.0) - i64::from(at.0)).clamp(-700, 700) as i32));
                if at == to { scan.arrived(to) } else { scan.sample(at, draw.value()) }
            }
            Ask::Think => scan.think(),
            Ask::Wait => scan.arrived(at),
            Ask::Ended(_) => break,
        };
        let _ = scan.summary();
    }
    true
}

#[test]
fn any_answers_are_taken_without_a_panic() {
    let begun = (0..1_000).filter(|seed| play(*seed, 0)).count() + (0..1_000).filter(|seed| play(*seed, 30)).count();
    assert!(begun > 800, "only {begun} scans began");
}
