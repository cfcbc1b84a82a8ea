//! Homing, limit switches, the emergency-stop input; settings and moves that are refused.

mod motion_model;

use motion_model::Mock;
use parfocal_firmware::motion::{Ending, Motion, MotionEvent};
use parfocal_protocol::message::{Field, HomingFault, Refusal, StopCause, Trust};
use parfocal_protocol::settings::{AxisSettings, Driver, Edges, Polarity, Side};
use parfocal_protocol::units::*;

/// A stage whose switches close at positions (steps as the pins tell them), bouncing as they do.
struct Stage {
    low: i32,
    high: i32,
    stuck: bool,
    /// DIR as last seen.
    up: bool,
}

fn run(board: &mut Mock, motion: &mut Motion, stage: &mut Stage, ms: u64) -> Vec<MotionEvent> {
    let mut events = Vec::new();
    let (mut at, mut counted) = (0, 0);
    for _ in 0..ms * 2 {
        let fresh = &board.bench.changes[counted..];
        counted += fresh.len();
        // DIR as of the last change on axis 0; steps follow.
        for c in fresh.iter().filter(|c| c.axis == 0) {
            if !c.step {
                stage.up = c.high;
            } else if c.high {
                at += if stage.up { 1 } else { -1 };
            }
        }
        let noise = (board.bench.timers.tick() / 42_000).is_multiple_of(3);
        let near = |edge: i32| (at - edge).abs() <= 2 && noise;
        let s = *motion.settings(Axis(0));
        let pressed = |p: bool| p == (s.switches == Polarity::PressedHigh);
        board.inputs.low_switch[0] = pressed(stage.stuck || (at <= stage.low) ^ near(stage.low));
        board.inputs.high_switch[0] = pressed((at >= stage.high) ^ near(stage.high));
        while let Some(event) = motion.poll(board.now(), board) {
            events.push(event);
        }
        if !events.is_empty() {
            return events;
        }
        board.bench.run(42_000);
    }
    events
}

fn homing(side: Side, polarity: Polarity, low: i32, high: i32, stuck: bool) -> (Mock, Motion, Vec<MotionEvent>) {
    let (mut board, mut motion) = (Mock::new(), Motion::new());
    let s = AxisSettings {
        home: Some(side),
        has_switches: true,
        switches: polarity,
        home_at: Nanometres(-70_000),
        backlash: Nanometres(1_000),
        low: Nanometres(-200_000),
        high: Nanometres(200_000),
        ..AxisSettings::default()
    };
    motion.configure(&mut board, Axis(0), &s).unwrap();
    let mut stage = Stage { low, high, stuck, up: false };
    // Lets the switches settle.
    run(&mut board, &mut motion, &mut stage, 5);
    motion.home(board.now(), &mut board, Axis(0)).unwrap();
    let events = run(&mut board, &mut motion, &mut stage, 60_000);
    (board, motion, events)
}

#[test]
fn homing_finds_the_edge_of_the_switch() {
    for polarity in [Polarity::PressedHigh, Polarity::PressedLow] {
        for (side, low, high) in [(Side::Low, -800, 5_000), (Side::High, -5_000, 900), (Side::Low, 50, 5_000)] {
            let (mut board, motion, events) = homing(side, polarity, low, high, false);
            assert!(matches!(events[..], [MotionEvent::InPosition(_)]), "{side:?} {events:?}");
            let status = motion.status(&mut board, Axis(0));
            assert_eq!(status.trust, Trust::Known);
            // Where the axis rests, told from the pins, is so far from the switch's edge as from the home position.
            let seen = board.seen(0, false, false);
            let edge = if side == Side::Low { low } else { high };
            let off = f64::from(seen - edge) * 100.0 - f64::from(status.position.0 + 70_000);
            assert!(off.abs() <= 500.0, "{side:?}: {off} nm off");
        }
    }
}

#[test]
fn homing_tells_what_is_wrong_with_the_switch() {
    let fault = |events: Vec<MotionEvent>| match events[..] {
        [MotionEvent::Stopped { cause: StopCause::Homing { fault, .. }, .. }] => fault,
        _ => panic!("{events:?}"),
    };
    let far = 1_000_000;
    assert_eq!(fault(homing(Side::Low, Polarity::PressedHigh, -far, far, false).2), HomingFault::Missing);
    assert_eq!(fault(homing(Side::Low, Polarity::PressedHigh, 0, far, true).2), HomingFault::Stuck);
    // The motor runs the other way than thought: the far switch is met first.
    assert_eq!(fault(homing(Side::High, Polarity::PressedHigh, -far, far, false).2), HomingFault::Missing);
    let (_, _, events) = homing(Side::Low, Polarity::PressedHigh, -far, -10, false);
    assert_eq!(fault(events), HomingFault::WrongSide);
    // Pressed at both ends, as when the polarity is set wrong: nothing moves.
    let (board, _, events) = homing(Side::Low, Polarity::PressedHigh, 1_000, -1_000, false);
    assert_eq!(fault(events), HomingFault::Stuck);
    assert_eq!(board.seen(0, false, false), 0);
}

#[test]
fn a_limit_switch_stops_the_way_towards_it_only() {
    let (mut board, mut motion) = (Mock::new(), Motion::new());
    let s = AxisSettings { has_switches: true, ..AxisSettings::default() };
    motion.configure(&mut board, Axis(0), &s).unwrap();
    let mut stage = Stage { low: -10_000, high: 2_000, stuck: false, up: false };
    run(&mut board, &mut motion, &mut stage, 5);
    let go = |board: &mut Mock, motion: &mut Motion, um: i32| {
        let to = [Some(Nanometres(um * 1000)), None, None, None];
        motion.move_to(board.now(), board, &to, None, Ending::Approach)
    };
    let id = go(&mut board, &mut motion, 500).unwrap();
    let cause = StopCause::HardLimit { axis: Axis(0), side: Side::High };
    assert_eq!(run(&mut board, &mut motion, &mut stage, 5000), [MotionEvent::Stopped { motion: id, cause }]);
    assert!(motion.status(&mut board, Axis(0)).at_high);
    assert_eq!(motion.steps(&mut board)[0].0, board.seen(0, false, false));
    assert_eq!(go(&mut board, &mut motion, 600), Err(Refusal::AtHardLimit { axis: Axis(0), side: Side::High }));
    let jog = motion.jog(board.now(), &mut board, Axis(0), MicrometresPerSecond(10.0));
    assert_eq!(jog, Err(Refusal::AtHardLimit { axis: Axis(0), side: Side::High }));
    let away = go(&mut board, &mut motion, 0).unwrap();
    assert_eq!(board.run(&mut motion, 5000, |_| true), [MotionEvent::InPosition(away)]);
}

#[test]
fn the_emergency_input_stops_everything_until_it_is_released_and_cleared() {
    let (mut board, mut motion) = (Mock::new(), Motion::new());
    motion.set_emergency_wired(true);
    let to = [Some(Nanometres(500_000)), None, None, None];
    let id = motion.move_to(board.now(), &mut board, &to, None, Ending::Approach).unwrap();
    board.run(&mut motion, 200, |_| false);
    board.inputs.emergency = true;
    let events = board.run(&mut motion, 2, |_| false);
    let stopped = MotionEvent::Stopped { motion: id, cause: StopCause::Emergency };
    assert_eq!(events, [stopped, MotionEvent::EmergencyInput { pressed: true }]);
    assert!(!board.on && motion.emergency_in_force());
    assert_eq!(motion.move_to(board.now(), &mut board, &to, None, Ending::Approach), Err(Refusal::Emergency));
    assert_eq!(motion.clear_emergency(board.now(), &mut board), Err(Refusal::Emergency));
    board.inputs.emergency = false;
    assert_eq!(board.run(&mut motion, 10, |_| false), [MotionEvent::EmergencyInput { pressed: false }]);
    motion.clear_emergency(board.now(), &mut board).unwrap();
    motion.move_to(board.now(), &mut board, &to, None, Ending::Approach).unwrap();
    assert_eq!(motion.status(&mut board, Axis(0)).trust, Trust::Lost);
}

#[test]
fn settings_out_of_range_are_refused_by_name() {
    let (mut board, mut motion) = (Mock::new(), Motion::new());
    let d = AxisSettings::default();
    let fast = MicrometresPerSecond(60_000.0);
    let cases = [
        (AxisSettings { steps_per_um: StepsPerMicrometre(0.0), ..d }, Field::StepsPerUm),
        (AxisSettings { steps_per_um: StepsPerMicrometre(-10.0), ..d }, Field::StepsPerUm),
        (AxisSettings { microsteps: 0, ..d }, Field::Microsteps),
        (AxisSettings { speed: MicrometresPerSecond(0.0), ..d }, Field::Speed),
        // 600,000 steps/s: more than an A4988 takes.
        (AxisSettings { speed: fast, ..d }, Field::Speed),
        (AxisSettings { acceleration: MicrometresPerSecond2(-1.0), ..d }, Field::Acceleration),
        (AxisSettings { acceleration: MicrometresPerSecond2(1e9), ..d }, Field::Acceleration),
        (AxisSettings { jerk: MicrometresPerSecond3(0.0), ..d }, Field::Jerk),
        (AxisSettings { jerk: MicrometresPerSecond3(1e30), ..d }, Field::Jerk),
        (AxisSettings { low: Nanometres(5), high: Nanometres(-5), ..d }, Field::High),
        (AxisSettings { low: Nanometres(i32::MIN), ..d }, Field::Low),
        (AxisSettings { backlash: Nanometres(-1), ..d }, Field::Backlash),
        (AxisSettings { settling: Milliseconds(100_000), ..d }, Field::Settling),
        (AxisSettings { home_speed: MicrometresPerSecond(2_000.0), ..d }, Field::HomeSpeed),
        (AxisSettings { home_at: Nanometres(i32::MAX), ..d }, Field::HomeAt),
    ];
    for (settings, expected) in cases {
        let refusal = motion.configure(&mut board, Axis(0), &settings);
        let Err(Refusal::OutOfRange { field, low, high }) = refusal else { panic!("{expected:?}: {refusal:?}") };
        assert_eq!(field, expected);
        assert!(low <= high, "{field:?}: {low}..{high}");
    }
    for broken in [f32::NAN, f32::INFINITY] {
        let settings = AxisSettings { jerk: MicrometresPerSecond3(broken), ..d };
        let refusal = motion.configure(&mut board, Axis(0), &settings);
        assert!(matches!(refusal, Err(Refusal::OutOfRange { field: Field::Jerk, .. })), "{refusal:?}");
    }
    assert_eq!(motion.settings(Axis(0)), &d, "nothing refused is kept");
    let both = AxisSettings { driver: Driver::Tmc2209, edges: Edges::Both, speed: fast, home_speed: fast, ..d };
    let quick = AxisSettings {
        speed: MicrometresPerSecond(365_000.0),
        acceleration: MicrometresPerSecond2(1e6),
        jerk: MicrometresPerSecond3(1e8),
        ..both
    };
    assert_eq!(motion.configure(&mut board, Axis(0), &quick), Ok(()), "3.65 million steps/s with both edges");
}

#[test]
fn impossible_moves_are_refused_when_asked_for() {
    let (mut board, mut motion) = (Mock::new(), Motion::new());
    let now = board.now();
    let mut go = |to: i32, speed: Option<f32>| {
        let to = [Some(Nanometres(to)), None, None, None];
        motion.move_to(now, &mut board, &to, speed.map(MicrometresPerSecond), Ending::Approach)
    };
    assert!(matches!(go(1_000_001, None), Err(Refusal::BeyondLimit { axis: Axis(0), .. })));
    assert!(matches!(go(-1_000_001, None), Err(Refusal::BeyondLimit { .. })));
    for speed in [0.0, -1.0, 1e-9, 1_001.0, 1e30] {
        assert!(matches!(go(1000, Some(speed)), Err(Refusal::OutOfRange { field: Field::Speed, .. })), "{speed}");
    }
    assert_eq!(go(1000, Some(f32::NAN)), Err(Refusal::NotANumber));
    for i in 1..=8 {
        assert!(go(1000 * i, Some(1_000.0)).is_ok());
    }
    assert!(go(1, None).is_ok());
    assert_eq!(go(1, None), Err(Refusal::QueueFull));
    let s = AxisSettings { has_switches: false, home: Some(Side::Low), ..AxisSettings::default() };
    assert_eq!(motion.configure(&mut board, Axis(0), &s), Err(Refusal::Busy));
    assert_eq!(motion.jog(now, &mut board, Axis(1), MicrometresPerSecond(5.0)), Err(Refusal::Busy));
    assert_eq!(motion.set_position(&mut board, Axis(1), Nanometres(5)), Err(Refusal::Busy));
    assert!(matches!(motion.home(now, &mut board, Axis(9)), Err(Refusal::NoSuchAxis { axis: Axis(9) })));
    let events = board.run(&mut motion, 3000, |_| false);
    assert_eq!(events.len(), 9, "every move of the queue told when it was in position");
    assert!(motion.in_position());
    assert_eq!(motion.home(board.now(), &mut board, Axis(0)), Err(Refusal::NoHomeSwitch { axis: Axis(0) }));
}
