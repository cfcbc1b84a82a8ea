//! Scans on curves that make sense, and on those that do not.

use parfocal_firmware::autofocus::{Ask, Scan, Summary};
use parfocal_protocol::autofocus::{FrameFault, Mode, Outcome, ScanId, ScanParameters, ScanRefusal, Strategy, Subject};
use parfocal_protocol::message::{Field, Refusal};
use parfocal_protocol::units::{Axis, FocusValue, MicrometresPerSecond, Milliseconds, Nanometres};

const STRATEGIES: [Strategy; 2] = [Strategy::Climb, Strategy::Scan];
const NOISES: [f64; 4] = [0.0, 1e-5, 0.001, 0.01];

fn parameters(range_um: i32) -> ScanParameters {
    ScanParameters {
        scan: ScanId(1),
        axis: Axis(2),
        strategy: Strategy::Climb,
        mode: Mode::Step,
        subject: Subject::Peak,
        low: Nanometres(-range_um * 1000),
        high: Nanometres(range_um * 1000),
        sample_step: Nanometres(500),
        trap: Nanometres(10_000),
        probe: Nanometres(5_000),
        speed: MicrometresPerSecond(0.0),
        sample_timeout: Milliseconds(1_000),
        verify: false,
    }
}

/// Normal deviates by the sum of twelve uniform ones: enough for noise, the same everywhere.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut uniform = || {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }
}

/// Plays a scan; `value` is told the number of the frame and z in µm.
fn play(
    parameters: &ScanParameters,
    start_um: f64,
    mut value: impl FnMut(u32, f64) -> Result<f64, FrameFault>,
) -> (Outcome, Summary, f64) {
    let start = Nanometres((start_um * 1000.0) as i32);
    let (mut scan, mut ask) = Scan::begin(parameters, start).unwrap();
    let (mut frames, mut z_end) = (0, start);
    loop {
        ask = match ask {
            Ask::Sample { z } => {
                assert!(z >= parameters.low && z <= parameters.high, "{z:?} is outside the range");
                frames += 1;
                assert!(frames < 20_000, "the scan never ends");
                scan.sample(z, value(frames - 1, z.micrometres().0).map(FocusValue))
            }
            Ask::Go { z } => {
                z_end = z;
                scan.arrived(z)
            }
            Ask::Think => scan.think(),
            Ask::Ended(outcome) => return (outcome, scan.summary(), z_end.micrometres().0),
            Ask::Sweep { .. } | Ask::Wait => panic!("a stepwise scan sweeps"),
        };
    }
}

fn refused(
    parameters: &ScanParameters,
    start_um: f64,
    why: ScanRefusal,
    value: impl FnMut(u32, f64) -> Result<f64, FrameFault>,
) {
    let (outcome, _, z) = play(parameters, start_um, value);
    assert_eq!(outcome, Outcome::Refused(why), "{:?} from {start_um}", parameters.strategy);
    assert!((z - start_um).abs() < 0.001, "the axis is left at {z}, not at its start {start_um}");
}

fn peak(z: f64, at: f64, width: f64) -> f64 {
    0.2 + 1.0 / (1.0 + ((z - at) / width).powi(2))
}

#[test]
fn a_peak_is_found_whatever_the_noise_and_the_start() {
    for strategy in STRATEGIES {
        for (k, noise) in NOISES.into_iter().enumerate() {
            for start in [-95.0, -41.3, 0.0, 12.0, 37.2, 99.9] {
                let p = ScanParameters { strategy, verify: true, ..parameters(100) };
                let mut g = Noise(k as u64 + 77);
                let (outcome, found, z) = play(&p, start, |_, z| Ok(peak(z, 30.0, 12.0) * (1.0 + noise * g.next())));
                assert_eq!(outcome, Outcome::Focused, "{strategy:?}, noise {noise}, from {start}");
                assert!((z - 30.0).abs() < 1.0, "{strategy:?}, noise {noise}, from {start}: {z}");
                assert_eq!(found.best.micrometres().0, z);
            }
        }
    }
}

#[test]
fn without_noise_the_bound_on_the_way_is_kept() {
    for start in (-99..100).map(f64::from) {
        let (outcome, found, _) = play(&parameters(100), start, |_, z| Ok(peak(z, 17.0, 9.0)));
        let excess = found.travel.micrometres().0 - (start - 17.0).abs() - 5.0;
        assert_eq!(outcome, Outcome::Focused);
        assert!(excess <= if (start - 17.0).abs() > 20.0 { 25.5 } else { 45.0 }, "{excess} µm from {start}");
    }
}

#[test]
fn a_blank_or_saturated_camera_is_refused_at_once() {
    for (fault, why) in [
        (FrameFault::Blank, ScanRefusal::NoContrast),
        (FrameFault::Saturated, ScanRefusal::Saturated),
        (FrameFault::Stale, ScanRefusal::StaleFrames),
        (FrameFault::NoFrame, ScanRefusal::SamplesStopped),
    ] {
        refused(&parameters(100), 3.0, why, |_, _| Err(fault));
        // In the middle of a scan, too.
        refused(&parameters(100), 3.0, why, |k, z| if k < 20 { Ok(peak(z, 40.0, 20.0)) } else { Err(fault) });
    }
}

#[test]
fn a_single_fault_or_a_value_that_is_no_number_is_asked_for_again() {
    for bad in [Ok(f64::NAN), Ok(f64::INFINITY), Err(FrameFault::Stale), Err(FrameFault::Blank)] {
        let (outcome, _, z) =
            play(&parameters(100), 0.0, |k, z| if k % 5 == 3 { bad } else { Ok(peak(z, 30.0, 12.0)) });
        assert_eq!(outcome, Outcome::Focused);
        assert!((z - 30.0).abs() < 0.5, "{bad:?}: {z}");
    }
    refused(&parameters(100), 0.0, ScanRefusal::SamplesStopped, |_, _| Ok(f64::NAN));
}

#[test]
fn a_flat_curve_is_refused() {
    for strategy in STRATEGIES {
        let p = ScanParameters { strategy, ..parameters(60) };
        refused(&p, 10.0, ScanRefusal::NoContrast, |_, _| Ok(0.0));
        refused(&p, 10.0, ScanRefusal::NoContrast, |_, _| Ok(3.25e7));
        // Nothing but noise: which of the refusals is a matter of chance, that it is one is not.
        for seed in 0..40 {
            let mut g = Noise(seed);
            let noise = [1e-5, 0.001, 0.01, 0.1][seed as usize % 4];
            let (outcome, _, z) = play(&p, 10.0, |_, _| Ok(5.0 * (1.0 + noise * g.next())));
            assert!(matches!(outcome, Outcome::Refused(_)), "{strategy:?}, seed {seed}: focused on noise at {z}");
            assert_eq!(z, 10.0);
        }
    }
}

#[test]
fn a_peak_at_or_beyond_an_end_of_the_range_is_refused() {
    for strategy in STRATEGIES {
        for (k, noise) in NOISES.into_iter().enumerate() {
            for at in [60.0, 59.6, 61.0, 75.0, 90.0, -60.0, -70.0] {
                for width in [8.0, 30.0] {
                    for start in [-55.0, 0.0, 41.0] {
                        let mut g = Noise((k + 1) as u64 * 31);
                        let p = ScanParameters { strategy, ..parameters(60) };
                        let value = |_, z| Ok(peak(z, at, width) * (1.0 + noise * g.next()));
                        let (outcome, _, z) = play(&p, start, value);
                        let far_in_noise = noise > 0.0 && outcome == Outcome::Refused(ScanRefusal::NoSignificantPeak);
                        let edge = outcome == Outcome::Refused(ScanRefusal::PeakAtEdge);
                        assert!(
                            edge || far_in_noise,
                            "{strategy:?}, noise {noise}, at {at} ± {width} from {start}: {outcome:?}"
                        );
                        assert_eq!(z, start);
                    }
                }
            }
        }
    }
}

#[test]
fn two_far_peaks_alike_are_refused_where_both_are_seen() {
    let value = |z: f64| peak(z, -40.0, 8.0) + 0.97 * peak(z, 35.0, 8.0);
    let p = ScanParameters { strategy: Strategy::Scan, ..parameters(100) };
    for (k, noise) in NOISES.into_iter().enumerate() {
        let mut g = Noise(k as u64 + 5);
        refused(&p, 0.0, ScanRefusal::TwoPeaks, |_, z| Ok(value(z) * (1.0 + noise * g.next())));
    }
    // A lower one does not matter.
    let (outcome, _, z) = play(&p, 0.0, |_, z| Ok(peak(z, -40.0, 8.0) + 0.5 * peak(z, 35.0, 8.0)));
    assert_eq!(outcome, Outcome::Focused);
    assert!((z + 40.0).abs() < 0.5);
}

#[test]
fn two_lobes_around_nothing_are_a_phase_object() {
    let lobes = |z: f64| {
        let x = (z - 6.0) / 4.0;
        1.0 + 40.0 * x * x * (-x * x).exp()
    };
    for start in [-30.0, 0.0, 3.0, 6.0, 20.0] {
        refused(&parameters(50), start, ScanRefusal::PhaseObject, |_, z| Ok(lobes(z)));
        let p = ScanParameters { subject: Subject::PhaseObject, verify: true, ..parameters(50) };
        let (outcome, _, z) = play(&p, start, |_, z| Ok(lobes(z)));
        assert_eq!(outcome, Outcome::Focused);
        assert!((z - 6.0).abs() < 0.1, "{z}");
    }
    // A single peak is none.
    let p = ScanParameters { subject: Subject::PhaseObject, ..parameters(50) };
    refused(&p, 0.0, ScanRefusal::NoSignificantPeak, |_, z| Ok(peak(z, 10.0, 5.0)));
}

#[test]
fn drifting_light_is_refused() {
    for rate in [0.002, -0.002] {
        refused(&parameters(100), 0.0, ScanRefusal::LightDrifts, |k, z| {
            Ok(peak(z, 30.0, 12.0) * (1.0 + rate * f64::from(k)))
        });
    }
}

#[test]
fn a_last_look_that_is_blurrier_is_refused() {
    let p = ScanParameters { verify: true, ..parameters(100) };
    let (_, found, _) = play(&p, 0.0, |_, z| Ok(peak(z, 30.0, 12.0)));
    // Something moves out of focus just before the last frame.
    let last = found.frames - 1;
    let value = |k, z| Ok(if k < last { peak(z, 30.0, 12.0) } else { peak(z, 60.0, 12.0) });
    refused(&p, 0.0, ScanRefusal::NotReproduced, value);
}

#[test]
fn a_start_near_the_peak_is_not_left_for_a_worse_place() {
    let p = ScanParameters { verify: true, ..parameters(100) };
    // The start is nearly as sharp as the peak; before the last look the object moves back to where the start is sharp.
    let (_, found, _) = play(&p, 0.0, |_, z| Ok(peak(z, 4.0, 12.0)));
    for moved in [1.0, 2.0, 3.0] {
        let last = found.frames - 1;
        let value = |k, z| Ok(peak(z, if k < last { 4.0 } else { 4.0 - 4.0 * moved }, 12.0));
        let (outcome, _, z) = play(&p, 0.0, value);
        let (here, start) = (peak(z, 4.0 - 4.0 * moved, 12.0), peak(0.0, 4.0 - 4.0 * moved, 12.0));
        assert!(z == 0.0 || here >= peak(0.0, 4.0, 12.0), "{outcome:?} at {z}: {here}, {start} at the start");
    }
}

#[test]
fn a_phase_object_that_moved_before_the_last_look_is_refused() {
    let lobes = |z: f64| 1.0 + 40.0 * (z / 4.0) * (z / 4.0) * (-(z / 4.0) * (z / 4.0)).exp();
    let p = ScanParameters { subject: Subject::PhaseObject, verify: true, ..parameters(50) };
    let (outcome, found, z) = play(&p, 10.0, |_, z| Ok(lobes(z)));
    assert!(outcome == Outcome::Focused && z.abs() < 0.1, "{outcome:?} at {z}");
    let last = found.frames - 1;
    refused(&p, 10.0, ScanRefusal::NotReproduced, |k, z| Ok(lobes(if k < last { z } else { z - 4.0 })));
}

#[test]
fn an_end_from_outside_returns_to_the_start() {
    let (mut scan, ask) = Scan::begin(&parameters(100), Nanometres(1_000)).unwrap();
    assert_eq!(ask, Ask::Sample { z: Nanometres(1_000) });
    scan.sample(Nanometres(1_000), Ok(FocusValue(1.0)));
    assert_eq!(scan.abort(ScanRefusal::Aborted), Ask::Go { z: Nanometres(1_000) });
    // Late samples change nothing; a second reason neither.
    assert_eq!(scan.sample(Nanometres(2_000), Ok(FocusValue(9.0))), Ask::Wait);
    assert_eq!(scan.abort(ScanRefusal::SamplesStopped), Ask::Go { z: Nanometres(1_000) });
    let ended = Ask::Ended(Outcome::Refused(ScanRefusal::Aborted));
    assert_eq!(scan.arrived(Nanometres(1_000)), ended);
    assert_eq!(scan.cut(ScanRefusal::MotionStopped), ended);
    assert_eq!(scan.summary().outcome, Some(Outcome::Refused(ScanRefusal::Aborted)));
}

#[test]
fn parameters_that_make_no_sense_are_refused_by_name() {
    let good = parameters(100);
    let refused = |p: ScanParameters, start: i32| match Scan::begin(&p, Nanometres(start)) {
        Err(Refusal::OutOfRange { field, .. }) => Some(field),
        _ => None,
    };
    assert_eq!(refused(good, 0), None);
    assert_eq!(refused(good, 100_001), Some(Field::ScanRange));
    assert_eq!(refused(ScanParameters { low: Nanometres(5), high: Nanometres(5), ..good }, 5), Some(Field::ScanRange));
    assert_eq!(
        refused(ScanParameters { low: Nanometres(i32::MIN), high: Nanometres(i32::MAX), ..good }, 0),
        Some(Field::ScanRange)
    );
    for step in [i32::MIN, -500, 0, 1, 200_001] {
        assert_eq!(
            refused(ScanParameters { sample_step: Nanometres(step), ..good }, 0),
            Some(Field::SampleStep),
            "{step}"
        );
    }
    for trap in [i32::MIN, 0, 499, 70_000, i32::MAX] {
        assert_eq!(refused(ScanParameters { trap: Nanometres(trap), ..good }, 0), Some(Field::Trap), "{trap}");
    }
    assert_eq!(refused(ScanParameters { probe: Nanometres(0), ..good }, 0), Some(Field::Probe));
    for speed in [f32::NAN, f32::INFINITY, -1.0] {
        assert_eq!(refused(ScanParameters { speed: MicrometresPerSecond(speed), ..good }, 0), Some(Field::Speed));
    }
    assert_eq!(refused(ScanParameters { sample_timeout: Milliseconds(0), ..good }, 0), Some(Field::SampleTimeout));
    let wide = ScanParameters { mode: Mode::Sweep, low: Nanometres(-200_000), high: Nanometres(200_000), ..good };
    assert_eq!(refused(wide, 0), Some(Field::SampleStep), "a sweep keeps its whole range");
    assert_eq!(refused(ScanParameters { sample_step: Nanometres(1_600), ..wide }, 0), None);
}

#[test]
fn a_scan_fits_the_board() {
    // Of it 2 KiB for what is worked out in slices.
    assert!(size_of::<Scan>() < 12 * 1024, "{} bytes", size_of::<Scan>());
}

/// A sweep: samples every `gap` nm that come `late` samples after they were exposed.
fn sweep(start_um: f64, gap: i32, late: usize, noise: f64) -> (Outcome, Summary) {
    uneven_sweep(start_um, gap, late, noise, 0.0)
}

/// The same, whose moving frames are exposed at most so many nm from where their time says.
fn uneven_sweep(start_um: f64, gap: i32, late: usize, noise: f64, uneven_nm: f64) -> (Outcome, Summary) {
    // A sweep keeps its whole range: half a micrometre a place is too fine for 400.
    let p = ScanParameters { mode: Mode::Sweep, sample_step: Nanometres(2_000), ..parameters(200) };
    let mut z = Nanometres((start_um * 1000.0) as i32);
    let (mut g, mut uneven) = (Noise(9), Noise(5));
    let mut value = |z: Nanometres| Ok(FocusValue(peak(z.micrometres().0, 30.0, 9.0) * (1.0 + noise * g.next())));
    let (mut scan, mut ask) = Scan::begin(&p, z).unwrap();
    let mut pending = std::collections::VecDeque::new();
    let mut leg = z;
    for _ in 0..20_000 {
        match ask {
            Ask::Sample { z: at } => {
                assert_eq!(at, z, "a sweep stands still for its frames at rest");
                ask = scan.sample(at, value(at));
                continue;
            }
            Ask::Go { z: to } => {
                z = to;
                pending.clear();
                ask = scan.arrived(to);
                continue;
            }
            Ask::Think => {
                ask = scan.think();
                continue;
            }
            Ask::Ended(outcome) => return (outcome, scan.summary()),
            Ask::Sweep { to } => leg = to,
            Ask::Wait => {}
        }
        // The stage moves on, whatever is decided meanwhile.
        let way = (leg.0 - z.0).clamp(-gap, gap);
        z = Nanometres(z.0 + way);
        pending.push_back(z);
        ask = Ask::Wait;
        if pending.len() > late || way == 0 {
            let at = pending.pop_front().unwrap();
            let beside = if way == 0 { 0.0 } else { uneven_nm * (uneven.next() / 2.0).clamp(-1.0, 1.0) };
            ask = scan.sample(at, value(Nanometres(at.0 + beside as i32)));
        }
        if way == 0 && pending.is_empty() && ask == Ask::Wait {
            ask = scan.arrived(z);
        }
    }
    panic!("the sweep never ends");
}

#[test]
fn uneven_timing_is_no_light_that_drifts() {
    for (gap, uneven_nm) in [(60, 0.0), (150, 0.0), (400, 0.0), (450, 150.0), (700, 300.0), (3_000, 900.0)] {
        for start in [-60.0, -20.0, 5.0, 55.0, 90.0] {
            let (outcome, found) = uneven_sweep(start, gap, 0, 0.0, uneven_nm);
            let what = format!("every {gap} nm, uneven by {uneven_nm} nm, from {start}");
            assert_eq!(outcome, Outcome::Focused, "{what}");
            let off = found.best.micrometres().0 - 30.0;
            assert!(off.abs() < 1.0, "{what}: {off} µm off");
        }
    }
}

#[test]
fn a_sweep_finds_the_peak_though_its_samples_come_late() {
    for noise in [0.0, 0.001, 0.01] {
        for late in [0, 4] {
            for start in [-150.0, -20.0, 25.0, 33.0, 100.0] {
                for gap in [700, 3_300] {
                    let (outcome, found) = sweep(start, gap, late, noise);
                    assert_eq!(outcome, Outcome::Focused, "noise {noise}, {late} late, from {start}, every {gap} nm");
                    let off = found.best.micrometres().0 - 30.0;
                    assert!(off.abs() < 1.0, "noise {noise}, {late} late, from {start}, every {gap} nm: {off} µm off");
                }
            }
        }
    }
}
