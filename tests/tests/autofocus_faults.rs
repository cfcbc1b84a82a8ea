//! Focusing what cannot be focused, through the real host, link and firmware: each is refused with its reason, and the axis goes
//! back. Light and objects that change at the last moment. Samples that no scan wants.

use parfocal::autofocus::recorded::StackSource;
use parfocal::autofocus::{CameraSource, Plan, Scanned, Span, focus};
use parfocal::focus::Measure;
use parfocal::frames::stack::Stack;
use parfocal::link::LinkError;
use parfocal_protocol::autofocus::{
    FocusSample, Mode, Outcome, ScanId, ScanParameters, ScanRefusal, ScanState, Strategy, Subject, SweepSample,
};
use parfocal_protocol::message::{Refusal, Request, Response};
use parfocal_protocol::units::{
    Axis, BoardTime, FocusValue, Micrometres, MicrometresPerSecond, Milliseconds, Nanometres,
};
use parfocal_simulator::model::RigModel;
use parfocal_tests::rig::{LOOKS, Shared, Target, gaussian, true_z};
use parfocal_tests::shared_data;

const MODES: [Mode; 2] = [Mode::Step, Mode::Sweep];

fn plan(mode: Mode) -> Plan {
    let range = Span { low: Micrometres(-100.0), high: Micrometres(100.0) };
    Plan { mode, range: Some(range), ..Plan::new("scope.z".parse().unwrap()) }
}

/// One scan from 40 µm on; what came of it, and where the carriage truly ended.
fn scan(plan: &Plan, target: impl FnOnce(&Shared) -> Target) -> (Scanned, f64) {
    let rig = Shared::new(RigModel::new(5));
    let mut source = CameraSource::new(target(&rig), None, Measure::Brenner, None);
    let scanned = focus(&mut rig.stage(), &mut source, plan, &mut |_| {}, &|| true).unwrap();
    (scanned, true_z(&rig).0)
}

const START: f64 = 40.0;

fn refused(plan: &Plan, why: &[ScanRefusal], target: impl FnOnce(&Shared) -> Target) {
    let (scanned, z) = scan(plan, target);
    let Outcome::Refused(said) = scanned.report.outcome else {
        panic!("{:?} {:?}: focused at {z}, expected one of {why:?}", plan.mode, plan.strategy)
    };
    assert!(why.contains(&said), "{:?} {:?}: {said:?}, expected one of {why:?}", plan.mode, plan.strategy);
    assert!((z - START).abs() < 0.05, "{said:?}: left at {z}");
    assert_eq!(scanned.report.end, scanned.report.start);
}

#[test]
fn what_cannot_be_focused_is_refused_with_its_reason_stepping_and_sweeping() {
    use ScanRefusal::{LightDrifts, NoContrast, NoSignificantPeak, PeakAtEdge, Saturated, TwoPeaks};
    for mode in MODES {
        for strategy in [Strategy::Climb, Strategy::Scan] {
            let plan = Plan { strategy, ..plan(mode) };
            for noise in [0, 60] {
                let noisy = move |target: Target| Target { noise, ..target };
                // In nothing but noise, which of them is a matter of chance.
                refused(&plan, &[NoContrast, NoSignificantPeak, PeakAtEdge], |rig| noisy(Target::new(rig, |_| 0.3)));
                refused(&plan, &[PeakAtEdge], |rig| noisy(Target::new(rig, gaussian(139.0, 40.0))));
                refused(&plan, &[PeakAtEdge], |rig| noisy(Target::new(rig, gaussian(-59.5, 40.0))));
                refused(&plan, &[PeakAtEdge], |rig| noisy(Target::new(rig, gaussian(165.0, 60.0))));
                let drifting = |rig: &Shared| {
                    let (mut peak, mut looks) = (gaussian(20.0, 30.0), 0.0);
                    noisy(Target::new(rig, move |z| {
                        looks += 1.0 / LOOKS as f64;
                        peak(z) * (1.0 - 0.004f64 * looks).max(0.05)
                    }))
                };
                refused(&plan, &[LightDrifts], drifting);
            }
            refused(&plan, &[NoContrast], |rig| Target::new(rig, |_| 0.0));
            refused(&plan, &[Saturated], |rig| Target { glare: true, ..Target::new(rig, |_| 0.5) });
        }
        let far = |rig: &Shared| {
            let (mut one, mut other) = (gaussian(0.0, 20.0), gaussian(95.0, 20.0));
            Target::new(rig, move |z| one(z) + 0.98 * other(z))
        };
        refused(&Plan { strategy: Strategy::Scan, ..plan(mode) }, &[TwoPeaks], far);
    }
}

#[test]
fn a_last_look_never_leaves_the_picture_blurrier_than_it_was_at_the_start() {
    for mode in MODES {
        let plan = Plan { verify: true, ..plan(mode) };
        let target = |rig: &Shared| Target::new(rig, gaussian(-10.0, 25.0));
        let frames = {
            let rig = Shared::new(RigModel::new(5));
            let mut source = CameraSource::new(target(&rig), None, Measure::Brenner, None);
            let scanned = focus(&mut rig.stage(), &mut source, &plan, &mut |_| {}, &|| true).unwrap();
            assert_eq!(scanned.report.outcome, Outcome::Focused);
            assert!((true_z(&rig).0 + 10.0).abs() < 0.5, "{}", true_z(&rig).0);
            source.camera.delivered.len()
        };
        // The light is dimmed, or the object moves, some frames before the end or right at it.
        for before in [1, 4] {
            let from = frames.saturating_sub(before);
            for (dimmed, moved) in [(0.5, 0.0), (1.0, 60.0), (0.2, 15.0)] {
                let (scanned, z) = scan(&plan, |rig| {
                    let (mut peak, mut looks) = (gaussian(-10.0, 25.0), 0usize);
                    Target::new(rig, move |z| {
                        looks += 1;
                        if looks / LOOKS >= from { dimmed * peak(z - moved) } else { peak(z) }
                    })
                });
                let mut after = gaussian(-10.0 + moved, 25.0);
                let (here, there) = (after(z), after(START));
                let case = format!("{mode:?}, {before} before the end, light {dimmed}, moved {moved}");
                match scanned.report.outcome {
                    Outcome::Focused => assert!(here >= 0.999 * there, "{case}: {here} at {z}, {there} at the start"),
                    Outcome::Refused(_) => assert!((z - START).abs() < 0.05, "{case}: left at {z}"),
                }
                if before == 1 {
                    assert_eq!(scanned.report.outcome, Outcome::Refused(ScanRefusal::NotReproduced), "{case}");
                }
            }
        }
    }
}

/// Parameters of a sweep over the microscope's z from where it is.
fn sweep() -> ScanParameters {
    ScanParameters {
        scan: ScanId(77),
        axis: Axis(2),
        strategy: Strategy::Scan,
        mode: Mode::Sweep,
        subject: Subject::Peak,
        low: Nanometres(-20_000),
        high: Nanometres(100_000),
        sample_step: Nanometres(500),
        trap: Nanometres(10_000),
        probe: Nanometres(5_000),
        speed: MicrometresPerSecond(100.0),
        sample_timeout: Milliseconds(1_000),
        verify: false,
    }
}

#[test]
fn samples_that_no_scan_wants_are_refused_by_name_and_the_scan_goes_on() {
    let rig = Shared::new(RigModel::new(1));
    let mut link = rig.link(0);
    let refusal = |link: &mut parfocal::link::Link, request: Request| match link.request(request) {
        Err(LinkError::Refused(refusal)) => refusal,
        other => panic!("{request:?}: {other:?}"),
    };
    let value = Ok(FocusValue(1.0));
    let sample = |index, value| Request::AutofocusSample(FocusSample { scan: ScanId(77), index, value });
    let swept = |index, at, value| {
        Request::AutofocusSweepSample(SweepSample { scan: ScanId(77), index, at: BoardTime(at), value })
    };
    // Before any scan.
    assert_eq!(refusal(&mut link, sample(0, value)), Refusal::NoSuchScan { current: None });
    for speed in [-1.0, f32::NAN, f32::INFINITY, 1e9] {
        let bad = ScanParameters { speed: MicrometresPerSecond(speed), ..sweep() };
        let said = refusal(&mut link, Request::AutofocusStart(bad));
        assert!(matches!(said, Refusal::OutOfRange { .. }), "{speed}: {said:?}");
    }
    let fine = ScanParameters { sample_step: Nanometres(100), ..sweep() };
    assert!(matches!(refusal(&mut link, Request::AutofocusStart(fine)), Refusal::OutOfRange { .. }));
    link.request(Request::AutofocusStart(sweep())).unwrap();
    let mut phi = gaussian(20.0, 15.0);
    let (mut next, mut tried, mut legs) = (0, false, 0);
    let status = |link: &mut parfocal::link::Link| match link.request(Request::Status).unwrap() {
        Response::Status(status) => status,
        other => panic!("{other:?}"),
    };
    let outcome = loop {
        let now = status(&mut link);
        match now.scan {
            ScanState::Ended(report) => break report,
            ScanState::Waiting(wanted) => {
                assert_eq!(wanted.index, next);
                let other = FocusSample { scan: ScanId(78), index: next, value };
                let said = refusal(&mut link, Request::AutofocusSample(other));
                assert_eq!(said, Refusal::NoSuchScan { current: Some(ScanId(77)) });
                assert_eq!(refusal(&mut link, sample(next + 1, value)), Refusal::WrongSample { wanted: next });
                for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                    assert_eq!(refusal(&mut link, sample(next, Ok(FocusValue(bad)))), Refusal::NotANumber);
                }
                assert_eq!(refusal(&mut link, swept(next, now.time.0, value)), Refusal::WrongSample { wanted: next });
                let good = Ok(FocusValue(phi(wanted.z.micrometres().0)));
                link.request(sample(next, good)).unwrap();
                assert!(matches!(refusal(&mut link, sample(next, good)), Refusal::WrongSample { .. }), "twice");
                next += 1;
            }
            ScanState::Sweeping(_) => {
                let z = now.axes[2].position.micrometres().0;
                let good = Ok(FocusValue(phi(z)));
                if tried || !now.axes[2].moving || z < -5.0 {
                    legs += 1;
                } else {
                    tried = true;
                    let told = now.time.0;
                    link.request(swept(next, told, good)).unwrap();
                    next += 1;
                    let wrong =
                        |said: Refusal| matches!(said, Refusal::WrongTime { earliest, .. } if earliest.0 == told);
                    assert_eq!(refusal(&mut link, swept(next - 1, told, good)), Refusal::WrongSample { wanted: next });
                    assert!(wrong(refusal(&mut link, swept(next, told - 1, good))), "out of order");
                    assert!(wrong(refusal(&mut link, swept(next, 0, good))), "long ago");
                    assert!(wrong(refusal(&mut link, swept(next, told + 1_000_000, good))), "not yet");
                    assert!(wrong(refusal(&mut link, swept(next, u64::MAX, good))), "never");
                    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                        let said = refusal(&mut link, swept(next, told + 1, Ok(FocusValue(bad))));
                        assert_eq!(said, Refusal::NotANumber);
                    }
                    let other = SweepSample { scan: ScanId(3), index: next, at: now.time, value: good };
                    let said = refusal(&mut link, Request::AutofocusSweepSample(other));
                    assert_eq!(said, Refusal::NoSuchScan { current: Some(ScanId(77)) });
                    assert!(matches!(refusal(&mut link, sample(next, good)), Refusal::WrongSample { .. }), "stepwise");
                    continue;
                }
                link.request(swept(next, now.time.0, good)).unwrap();
                // A gap: frames may be lost.
                next += 2;
                let until = rig.lock().now() + 10_000;
                rig.lock().advance(until);
            }
            ScanState::Moving(_) | ScanState::None => {
                let until = rig.lock().now() + 10_000;
                rig.lock().advance(until);
            }
        }
    };
    assert!(tried && legs > 10);
    assert_eq!(outcome.outcome, Outcome::Focused);
    assert!((outcome.best.micrometres().0 - 20.0).abs() < 0.2, "{outcome:?}");
    let late = refusal(&mut link, swept(next, 1, value));
    assert_eq!(late, Refusal::NoSuchScan { current: Some(ScanId(77)) });
}

#[test]
fn a_sweep_whose_frames_stop_coming_ends_and_goes_back() {
    let rig = Shared::new(RigModel::new(1));
    let mut link = rig.link(0);
    link.request(Request::AutofocusStart(sweep())).unwrap();
    let report = loop {
        let Response::Scan(state) = link.request(Request::AutofocusState).unwrap() else { panic!("no state") };
        match state {
            ScanState::Ended(report) => break report,
            ScanState::Waiting(wanted) => {
                let sample = FocusSample { scan: wanted.scan, index: wanted.index, value: Ok(FocusValue(1.0)) };
                link.request(Request::AutofocusSample(sample)).unwrap();
            }
            _ => {
                let until = rig.lock().now() + 50_000;
                rig.lock().advance(until);
            }
        }
    };
    assert_eq!(report.outcome, Outcome::Refused(ScanRefusal::SamplesStopped));
    assert_eq!((report.end, true_z(&rig).0.round()), (report.start, START));
}

#[test]
fn a_sweep_stopped_by_its_user_goes_back() {
    let rig = Shared::new(RigModel::new(1));
    let mut source = CameraSource::new(Target::new(&rig, gaussian(-150.0, 15.0)), None, Measure::Brenner, None);
    let plan = Plan { range: None, ..plan(Mode::Sweep) };
    let clock = rig.clone();
    let keep_on = move || clock.lock().now() < 1_500_000;
    let scanned = focus(&mut rig.stage(), &mut source, &plan, &mut |_| {}, &keep_on).unwrap();
    assert_eq!(scanned.report.outcome, Outcome::Refused(ScanRefusal::Aborted));
    assert!((true_z(&rig).0 - START).abs() < 0.05);
    assert!(scanned.samples.iter().any(|s| (s.z.0 - START).abs() > 20.0), "it had been under way");
}

/// The focus of the tip region of the real stack, from 50 starts: (success, J − J_min sorted).
fn tip(measure: Measure) -> (usize, Vec<f64>) {
    let stack = Stack::open(&shared_data("acq4_pipette_tip")).unwrap();
    let roi = stack.roi();
    let (low, high) = stack.extent();
    let values: Vec<f64> = stack
        .planes
        .iter()
        .map(|p| parfocal::focus::measure(p.view().crop(roi.unwrap()).unwrap(), measure).unwrap().0)
        .collect();
    let best = (0..values.len()).max_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap();
    let best = stack.z(best).0;
    let (mut found, mut excess) = (0, Vec::new());
    for k in 0..50 {
        let start = low.0 + (high.0 - low.0) * f64::from(k) / 49.0;
        let mut model = RigModel::new(k as u64);
        model.set_limits(0, Axis(2), low, high);
        model.set_position(0, Axis(2), Micrometres(start));
        let rig = Shared::new(model);
        let mut source = StackSource::new(stack.clone(), roi, measure).unwrap();
        let plan = Plan { extent: Some(Span { low, high }), ..Plan::new("scope.z".parse().unwrap()) };
        let report = focus(&mut rig.stage(), &mut source, &plan, &mut |_| {}, &|| true).unwrap().report;
        let z = report.end.micrometres().0;
        // The operator's plane is 25, Tenengrad's 24; the measure's own best counts, too.
        let off = |plane: f64| (z - plane).abs();
        if report.outcome == Outcome::Focused && off(best).min(off(24.0 * 1.57)).min(off(25.0 * 1.57)) <= 1.6 {
            found += 1;
        }
        excess.push(report.travel.micrometres().0 - (start - best).abs() - 5.0);
    }
    excess.sort_by(f64::total_cmp);
    (found, excess)
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn the_real_tip_is_found_from_fifty_starts_with_little_travel() {
    for measure in [Measure::Tenengrad, Measure::Brenner] {
        let (found, excess) = tip(measure);
        let (median, p95) = (excess[25], excess[47]);
        println!(
            "{measure}: {found} of 50, J - J_min median {median:.1} µm, p95 {p95:.1} µm, at most {:.1}",
            excess[49]
        );
        assert_eq!(found, 50, "{measure}");
        assert!(median <= 25.0 && p95 <= 45.0, "{measure}: {excess:?}");
    }
}
