//! A camera that only says when frames arrive, 20–150 ms late, on a stage with backlash, through the real host, link and firmware:
//! after one calibration, sweeps in both directions agree. And what a sweep takes.

use parfocal::autofocus::latency::{Calibrated, LatencyError, LatencyPlan, measure};
use parfocal::autofocus::{
    AutofocusError, CameraSource, Latency, Plan, Progress, ScanError, Scanned, SourceError, Span, focus,
};
use parfocal::focus::Measure;
use parfocal::stage::Stage;
use parfocal_protocol::autofocus::{Mode, Outcome, Strategy};
use parfocal_protocol::units::{Micrometres, MicrometresPerSecond};
use parfocal_simulator::camera::CameraTiming;
use parfocal_simulator::model::RigModel;
use parfocal_tests::rig::{Shared, Target, gaussian, true_z};

const PEAK: f64 = 4.3;
const BACKLASH: f64 = 3.0;

/// 30 frames/s, 5 ms exposure, 20–150 ms late, arrivals only.
const UNEVEN: CameraTiming =
    CameraTiming { period_us: 33_333, exposure_us: 5_000, latency_us: 20_000, jitter_us: 130_000, timestamps: false };

fn rig(seed: u64, timing: CameraTiming, backlash: f64) -> Shared {
    let mut model = RigModel::new(seed);
    model.camera.timing = timing;
    model.boards[0].axes[2].stage.backlash_um = backlash;
    // A worse crystal than most.
    model.boards[0].clock_ppm = 60.0;
    Shared::new(model)
}

fn source(rig: &Shared, latency: Option<Latency>) -> CameraSource<Target> {
    CameraSource::new(Target::new(rig, gaussian(PEAK, 15.0)), None, Measure::Brenner, latency)
}

fn plan() -> Plan {
    Plan::new("scope.z".parse().unwrap())
}

fn calibrate(stage: &mut Stage, source: &mut CameraSource<Target>) -> Result<Calibrated, LatencyError> {
    let plan = LatencyPlan {
        focus: plan(),
        peak: Micrometres(5.0),
        reach: Micrometres(40.0),
        slow: MicrometresPerSecond(40.0),
        fast: MicrometresPerSecond(100.0),
        repeats: 3,
    };
    measure(stage, source, &plan, &mut |_| {}, &|| true)
}

/// A sweep at 100 µm/s towards one side, over ±60 µm.
fn sweep(stage: &mut Stage, source: &mut CameraSource<Target>, up: bool) -> Scanned {
    let start = if up { -60.0 } else { 60.0 };
    let range = Span { low: Micrometres(-60.0 - start), high: Micrometres(60.0 - start) };
    let plan = Plan {
        start: Some(Micrometres(start)),
        range: Some(range),
        strategy: Strategy::Scan,
        mode: Mode::Sweep,
        speed: Some(MicrometresPerSecond(100.0)),
        ..plan()
    };
    focus(stage, source, &plan, &mut |_: Progress| {}, &|| true).unwrap()
}

#[test]
fn both_directions_agree_after_the_calibration() {
    let (mut worst, mut off, mut anew) = (0.0f64, 0.0f64, 0.0f64);
    // SEEDS=20 for more than every check can afford.
    let seeds = std::env::var("SEEDS").ok().and_then(|n| n.parse().ok()).unwrap_or(2);
    for seed in 0..seeds {
        let rig = rig(seed, UNEVEN, BACKLASH);
        let (mut stage, mut source) = (rig.stage(), source(&rig, None));
        let axis = plan().axis;
        let found = calibrate(&mut stage, &mut source).unwrap();
        assert!(!found.told && (found.backlash_um - BACKLASH).abs() < 0.25, "seed {seed}: {found:?}");
        // The board is told of the backlash, as the command does.
        let mut settings = stage.settings(axis).unwrap();
        settings.backlash = Micrometres(found.backlash_um).nanometres().unwrap();
        stage.set_settings(axis, settings).unwrap();
        let mut both = |source: &mut CameraSource<Target>| {
            let mut once = |up| {
                let scanned = sweep(&mut stage, source, up);
                assert_eq!(scanned.report.outcome, Outcome::Focused, "seed {seed}");
                (scanned.report.best.micrometres().0, true_z(&rig).0)
            };
            let (up, down) = (once(true), once(false));
            off = off.max((up.1 - PEAK).abs()).max((down.1 - PEAK).abs());
            (up.0 - down.0).abs().max((up.1 - down.1).abs())
        };
        let apart = both(&mut source);
        worst = worst.max(apart);
        assert!(apart < 0.2, "seed {seed}: {apart} µm apart, {found:?}");
        // Another program, another day: only the latency is known, the pace is learnt anew.
        let mut source = self::source(&rig, Some(found.latency));
        let apart = both(&mut source);
        anew = anew.max(apart);
        assert!(apart < 0.2, "seed {seed}, in a new session: {apart} µm apart, {found:?}");
    }
    println!(
        "directions differ by at most {worst:.3} µm, in a new session {anew:.3} µm; the stage rests within {off:.3} µm of the peak"
    );
    assert!(off < 0.3, "{off}");
}

#[test]
fn without_a_calibration_a_sweep_is_refused_and_says_what_to_do() {
    let rig = rig(1, UNEVEN, 0.0);
    let (mut stage, mut source) = (rig.stage(), source(&rig, None));
    let plan = Plan { mode: Mode::Sweep, ..plan() };
    let error = focus(&mut stage, &mut source, &plan, &mut |_| {}, &|| true).unwrap_err();
    assert!(matches!(&error, AutofocusError::Scan(ScanError::Source(SourceError::Uncalibrated { .. }))), "{error}");
    let said = error.to_string();
    assert!(said.contains("calibrate latency") && said.contains("--mode step"), "{said}");
    assert_eq!(stage.position(plan.axis).unwrap(), Micrometres(40.0), "nothing moved");
}

#[test]
fn a_camera_at_another_rate_than_calibrated_is_refused() {
    let rig = rig(1, CameraTiming { jitter_us: 3_000, ..UNEVEN }, 0.0);
    let latency = Latency { late_us: 20_000.0, period_us: 20_000.0, edge: Default::default() };
    let (mut stage, mut source) = (rig.stage(), source(&rig, Some(latency)));
    let plan = Plan { mode: Mode::Sweep, ..plan() };
    let said = focus(&mut stage, &mut source, &plan, &mut |_| {}, &|| true).unwrap_err().to_string();
    assert!(said.contains("30.00 frames/s, its latency was calibrated at 50.00"), "{said}");
}

#[test]
fn a_camera_that_tells_its_exposures_has_no_latency() {
    let rig = rig(2, CameraTiming { timestamps: true, ..UNEVEN }, 1.0);
    let (mut stage, mut source) = (rig.stage(), source(&rig, None));
    let found = calibrate(&mut stage, &mut source).unwrap();
    // The carriage follows its motor with a lag of 2 ms: the one thing that is late.
    assert!(found.told && (found.latency.late_us - 2_000.0).abs() < 1_000.0, "{found:?}");
    assert!((found.backlash_um - 1.0).abs() < 0.1, "{found:?}");
}

#[test]
fn a_stepwise_scan_on_an_uncalibrated_camera_trusts_no_frame_from_before_the_move() {
    let rig = rig(1, UNEVEN, 0.0);
    let (mut stage, mut source) = (rig.stage(), source(&rig, None));
    let plan = Plan { start: Some(Micrometres(15.0)), sample_step: Some(Micrometres(1.0)), ..plan() };
    let scanned = focus(&mut stage, &mut source, &plan, &mut |_| {}, &|| true).unwrap();
    assert_eq!(scanned.report.outcome, Outcome::Focused);
    assert!((true_z(&rig).0 - PEAK).abs() < 0.05, "{}", true_z(&rig).0);
}

#[test]
fn four_hundred_micrometres_at_100_frames_a_second_take_less_than_three() {
    for (strategy, start) in
        [(Strategy::Scan, 0.0), (Strategy::Scan, -200.0), (Strategy::Climb, 0.0), (Strategy::Climb, 190.0)]
    {
        let timing = CameraTiming { period_us: 10_000, exposure_us: 2_000, ..CameraTiming::default() };
        let rig = rig(3, timing, 0.0);
        let (mut stage, mut source) = (rig.stage(), source(&rig, None));
        stage.move_to(&[(plan().axis, Micrometres(start))], None, &|| true).unwrap();
        let plan = Plan { mode: Mode::Sweep, strategy, speed: Some(MicrometresPerSecond(400.0)), ..plan() };
        let before = rig.lock().now();
        let scanned = focus(&mut stage, &mut source, &plan, &mut |_| {}, &|| true).unwrap();
        let took = (rig.lock().now() - before) as f64 * 1e-6;
        println!("{strategy:?} from {start}: {took:.2} s, {} frames", scanned.report.frames);
        assert_eq!(scanned.report.outcome, Outcome::Focused);
        // The carriage lags by 2 ms, 0.8 µm at this speed.
        assert!((true_z(&rig).0 - PEAK).abs() < 1.1, "{}", true_z(&rig).0);
        assert!(took < 3.0, "{strategy:?} from {start}: {took} s");
        // The host kept up: no frame was dropped for its sake.
        let numbers = &source.camera.delivered;
        assert!(numbers.windows(2).all(|w| w[1] == w[0] + 1), "{numbers:?}");
    }
}
