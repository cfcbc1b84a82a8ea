//! A camera that only says when frames arrive, 20–150 ms late: after one calibration, sweeps in both directions agree.

use parfocal::autofocus::latency::{BothWays, Delays, separate};
use parfocal::frames::pacing::{Edge, Pacing};
use parfocal_firmware::autofocus::{Ask, Scan};
use parfocal_protocol::autofocus::{Mode, Outcome, ScanId, ScanParameters, Strategy, Subject};
use parfocal_protocol::units::{Axis, FocusValue, HostTime, MicrometresPerSecond, Milliseconds, Nanometres};

const PERIOD_US: f64 = 1e6 / 30.0;
const EXPOSURE_US: f64 = 5_000.0;
const BACKLASH_UM: f64 = 3.0;
const RANGE_UM: f64 = 60.0;

/// A camera that runs on, and its delivery.
struct Camera {
    pacing: Pacing,
    number: u64,
    random: u64,
}

impl Camera {
    fn uniform(&mut self) -> f64 {
        self.random = self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.random >> 11) as f64 / (1u64 << 53) as f64
    }

    /// The next frame: its number and the middle of its exposure, µs; it arrives late.
    fn frame(&mut self) -> (u64, f64) {
        let number = self.number;
        self.number += 1;
        let middle = 1e6 + number as f64 * PERIOD_US + EXPOSURE_US / 2.0;
        let delay = 20_000.0 + 130_000.0 * self.uniform();
        self.pacing.frame(number, HostTime((middle + EXPOSURE_US / 2.0 + delay) as u64));
        (number, middle)
    }
}

fn phi(z: f64) -> f64 {
    // A Gaussian of 15 µm FWHM.
    let s = 15.0 / 2.354_820_045;
    0.2 + (-(z - 4.3) * (z - 4.3) / (2.0 * s * s)).exp()
}

/// Mean of Φ over an exposure, the stage half the backlash behind the command.
fn exposed(command: f64, velocity: f64) -> f64 {
    let behind = command - velocity.signum() * BACKLASH_UM / 2.0;
    (-10..=10).map(|i| phi(behind + velocity * f64::from(i) / 20.0 * EXPOSURE_US * 1e-6)).sum::<f64>() / 21.0
}

/// One sweep of the whole range; the answer is where the board sees the peak.
fn sweep(camera: &mut Camera, velocity: f64) -> Nanometres {
    let from = -RANGE_UM * velocity.signum();
    let nm = |um: f64| Nanometres((um * 1000.0).round() as i32);
    let parameters = ScanParameters {
        scan: ScanId(1),
        axis: Axis(2),
        strategy: Strategy::Scan,
        mode: Mode::Sweep,
        subject: Subject::Peak,
        low: nm(-RANGE_UM),
        high: nm(RANGE_UM),
        sample_step: Nanometres(500),
        trap: Nanometres(10_000),
        probe: Nanometres(5_000),
        speed: MicrometresPerSecond(velocity.abs() as f32),
        sample_timeout: Milliseconds(1_000),
        verify: false,
    };
    let (mut scan, mut ask) = Scan::begin(&parameters, nm(from)).unwrap();
    while let Ask::Sample { z } = ask {
        ask = scan.sample(z, Ok(FocusValue(exposed(z.micrometres().0, velocity))));
    }
    assert!(matches!(ask, Ask::Sweep { .. }));
    let begin = camera.frame().1 + 1_000.0 + PERIOD_US * camera.uniform();
    let mut frames = Vec::new();
    loop {
        let (number, middle) = camera.frame();
        let z = from + velocity * (middle - begin) * 1e-6;
        if middle < begin {
            continue;
        }
        if z.abs() > RANGE_UM {
            break;
        }
        frames.push((number, exposed(z, velocity)));
    }
    let clock = camera.pacing.clock(Edge::Earliest).unwrap();
    for (number, value) in frames {
        // All that is known of the time: the camera's pace, from arrivals.
        let z = from + velocity * (clock.time(number).0 as f64 - begin) * 1e-6;
        let z = nm(z.clamp(-RANGE_UM, RANGE_UM));
        ask = scan.sample(z, Ok(FocusValue(value)));
    }
    if ask == Ask::Wait {
        ask = scan.arrived(nm(-from));
    }
    let Ask::Go { z } = ask else { panic!("{ask:?}: {:?}", scan.summary()) };
    assert_eq!(scan.arrived(z), Ask::Ended(Outcome::Focused));
    z
}

fn both(camera: &mut Camera, speed: f64) -> BothWays {
    let (up, down) = (sweep(camera, speed), sweep(camera, -speed));
    BothWays { speed: MicrometresPerSecond(speed as f32), up, down }
}

#[test]
fn both_directions_agree_after_the_calibration() {
    let mut worst = 0.0f64;
    for seed in 0..20 {
        let mut camera = Camera { pacing: Pacing::default(), number: 0, random: seed };
        // The camera has run for a minute.
        for _ in 0..1_800 {
            camera.frame();
        }
        let (slow, fast) = (both(&mut camera, 40.0), both(&mut camera, 100.0));
        let delays: Delays = separate(&slow, &fast).unwrap();
        assert!((delays.backlash_um - BACKLASH_UM).abs() < 0.3, "{delays:?}");
        let again = both(&mut camera, 100.0);
        let up = delays.correct(again.up, MicrometresPerSecond(100.0)).micrometres().0;
        let down = delays.correct(again.down, MicrometresPerSecond(-100.0)).micrometres().0;
        worst = worst.max((up - down).abs());
        assert!((up - down).abs() < 0.2, "seed {seed}: {up} up, {down} down");
        assert!((up - 4.3).abs() < 0.2, "seed {seed}: {up}");
    }
    println!("directions differ by at most {worst:.3} µm");
}
