//! Motion as the controller sees it, down to the edges.

mod motion_model;

use motion_model::Mock;
use parfocal_firmware::motion::{Ending, Motion, MotionEvent};
use parfocal_protocol::message::{Refusal, StopCause, TriggerPlan, Trust};
use parfocal_protocol::settings::{AxisSettings, Driver, Side};
use parfocal_protocol::units::*;

fn settings() -> AxisSettings {
    AxisSettings {
        driver: Driver::Tmc2209,
        low: Nanometres(-10_000_000),
        high: Nanometres(10_000_000),
        ..AxisSettings::default()
    }
}

fn ready(configure: impl Fn(&mut AxisSettings)) -> (Mock, Motion) {
    let (mut board, mut motion) = (Mock::new(), Motion::new());
    let mut s = settings();
    configure(&mut s);
    for axis in 0..4 {
        motion.configure(&mut board, Axis(axis), &s).unwrap();
    }
    (board, motion)
}

fn over(e: &MotionEvent) -> bool {
    matches!(e, MotionEvent::InPosition(_) | MotionEvent::Stopped { .. })
}

#[test]
fn a_move_arrives_and_says_so_after_settling() {
    let (mut board, mut motion) = ready(|_| {});
    let to = [Some(Nanometres(1_000_000)), Some(Nanometres(-250_000)), None, None];
    let id = motion.move_to(board.now(), &mut board, &to, None, Ending::Approach).unwrap();
    let events = board.run(&mut motion, 5000, over);
    assert_eq!(events, [MotionEvent::InPosition(id)]);
    assert_eq!(board.seen(0, false, false), 10_000);
    assert_eq!(board.seen(1, false, false), -2_500);
    assert_eq!(motion.status(&mut board, Axis(0)).position, Nanometres(1_000_000));
    assert!(motion.in_position());
}

#[test]
fn an_axis_ends_from_its_approach_side_with_play_taken_up() {
    let (mut board, mut motion) = ready(|s| {
        s.backlash = Nanometres(3_000);
        s.approach = Some(Side::Low);
    });
    for um in [100, 50, 60, -20] {
        motion
            .move_to(board.now(), &mut board, &[Some(Nanometres(um * 1000)), None, None, None], None, Ending::Approach)
            .unwrap();
        let events = board.run(&mut motion, 5000, over);
        assert_eq!(events.len(), 1);
        assert_eq!(motion.status(&mut board, Axis(0)).position, Nanometres(um * 1000));
        assert!(board.bench.steps(0, false).last().unwrap().1);
    }
}

#[test]
fn a_stop_keeps_the_position_exact() {
    for ms in [1, 5, 20, 60, 200, 400, 900, 1100] {
        let (mut board, mut motion) = ready(|_| {});
        let id = motion
            .move_to(
                board.now(),
                &mut board,
                &[Some(Nanometres(1_000_000)), Some(Nanometres(700_000)), None, None],
                None,
                Ending::Approach,
            )
            .unwrap();
        board.run(&mut motion, ms, |_| false);
        motion.stop(board.now(), &mut board, StopCause::Asked);
        let events = board.run(&mut motion, 5000, over);
        assert_eq!(events, [MotionEvent::Stopped { motion: id, cause: StopCause::Asked }], "{ms}");
        for axis in 0..2 {
            assert_eq!(motion.steps(&mut board)[axis].0, board.seen(axis, false, false), "{ms}");
        }
        assert_eq!(motion.status(&mut board, Axis(0)).trust, Trust::Unknown);
    }
}

#[test]
fn holding_and_going_on_ends_at_the_target() {
    let (mut board, mut motion) = ready(|_| {});
    let id = motion
        .move_to(
            board.now(),
            &mut board,
            &[Some(Nanometres(500_000)), Some(Nanometres(700_000)), None, None],
            None,
            Ending::Approach,
        )
        .unwrap();
    for _ in 0..5 {
        board.run(&mut motion, 150, |_| false);
        motion.hold(board.now(), &mut board);
        assert!(board.run(&mut motion, 300, |_| false).is_empty());
        motion.resume();
    }
    assert_eq!(board.run(&mut motion, 5000, over), [MotionEvent::InPosition(id)]);
    assert_eq!((board.seen(0, false, false), board.seen(1, false, false)), (5_000, 7_000));
}

#[test]
fn jogging_changes_speed_turns_round_and_ends_at_the_soft_limit() {
    let (mut board, mut motion) = ready(|s| s.high = Nanometres(300_000));
    let id = motion.jog(board.now(), &mut board, Axis(2), MicrometresPerSecond(100.0)).unwrap();
    for speed in [500.0, 900.0, 20.0, -300.0, -50.0, 400.0] {
        board.run(&mut motion, 130, |_| false);
        assert_eq!(motion.jog(board.now(), &mut board, Axis(2), MicrometresPerSecond(speed)), Ok(id), "{speed}");
    }
    assert_eq!(board.run(&mut motion, 5000, over), [MotionEvent::InPosition(id)]);
    assert_eq!(board.seen(2, false, false), 3_000);
    assert_eq!(motion.steps(&mut board)[2].0, 3_000);
    let limit = motion.jog(board.now(), &mut board, Axis(2), MicrometresPerSecond(1.0));
    assert!(matches!(limit, Err(Refusal::BeyondLimit { .. })));
}

#[test]
fn a_vibration_ends_where_it_began() {
    let (mut board, mut motion) = ready(|s| s.acceleration = MicrometresPerSecond2(20_000.0));
    let id = motion.vibrate(board.now(), &mut board, Axis(1), Nanometres(5_000), Hertz(8.0), 3).unwrap();
    assert_eq!(board.run(&mut motion, 5000, over), [MotionEvent::InPosition(id)]);
    assert_eq!(board.seen(1, false, false), 0);
    assert_eq!(board.bench.steps(1, false).len(), 50 + 4 * 3 * 50 + 50);
}

#[test]
fn an_emergency_keeps_counting_and_distrusts() {
    let (mut board, mut motion) = ready(|_| {});
    motion
        .move_to(board.now(), &mut board, &[Some(Nanometres(500_000)), None, None, None], None, Ending::Approach)
        .unwrap();
    board.run(&mut motion, 200, |_| false);
    board.bench.pass(1234);
    motion.emergency(board.now(), &mut board);
    assert_eq!(motion.steps(&mut board)[0].0, board.seen(0, false, false));
    assert_eq!(motion.status(&mut board, Axis(0)).trust, Trust::Lost);
    motion.clear_emergency(board.now(), &mut board).unwrap();
    board.run(&mut motion, 1, |_| false);
    board.bench.changes.clear();
    let before = motion.steps(&mut board)[0].0;
    motion.move_to(board.now(), &mut board, &[Some(Nanometres(0)), None, None, None], None, Ending::Approach).unwrap();
    board.run(&mut motion, 5000, over);
    assert_eq!(motion.steps(&mut board)[0].0, 0);
    assert_eq!(board.seen(0, false, false), -before);
}

#[test]
fn a_vibration_follows_its_cosine_and_stops_when_told() {
    for stop_after in [None, Some(100), Some(171), Some(222), Some(260)] {
        let (mut board, mut motion) = ready(|s| s.acceleration = MicrometresPerSecond2(20_000.0));
        let id = motion.vibrate(board.now(), &mut board, Axis(1), Nanometres(5_000), Hertz(8.0), 3).unwrap();
        let mut events = board.run(&mut motion, stop_after.unwrap_or(10_000), over);
        if stop_after.is_some() {
            motion.stop(board.now(), &mut board, StopCause::Asked);
            events = board.run(&mut motion, 300, over);
            assert_eq!(events, [MotionEvent::Stopped { motion: id, cause: StopCause::Asked }]);
        } else {
            assert_eq!(events, [MotionEvent::InPosition(id)]);
            // The swings' edges against the library's cosine, each within a tick.
            let steps = board.bench.steps(1, false);
            let swing = &steps[50..650];
            let omega = std::f64::consts::TAU * 8.0 / 84e6;
            let first = (1.0f64 - 0.5 / 50.0).acos() / omega;
            let begin = swing[0].0 as f64 - first;
            let mut at = 50.0f64;
            for (tick, up) in swing {
                let edge = if *up { at + 0.5 } else { at - 0.5 };
                at += if *up { 1.0 } else { -1.0 };
                let turns = ((*tick as f64 - begin) * omega / std::f64::consts::TAU).floor();
                let angle = if *up { std::f64::consts::TAU - (edge / 50.0).acos() } else { (edge / 50.0).acos() };
                let exact = (turns * std::f64::consts::TAU + angle) / omega;
                assert!((*tick as f64 - begin - exact).abs() <= 2.0, "{tick} {exact}");
            }
        }
        assert_eq!(motion.steps(&mut board)[1].0, board.seen(1, false, false), "{stop_after:?}");
    }
}

#[test]
fn camera_pulses_come_with_the_step() {
    let (mut board, mut motion) = ready(|s| s.backlash = Nanometres(2_000));
    board.run(&mut motion, 50, |_| false);
    let plan = TriggerPlan::Every { axis: Axis(0), first: Nanometres(20_000), every: Nanometres(1_500), count: 40 };
    motion.trigger(&mut board, &plan).unwrap();
    let to = [Some(Nanometres(100_000)), None, None, None];
    motion.move_to(board.now(), &mut board, &to, None, Ending::Approach).unwrap();
    let events = board.run(&mut motion, 1000, over);
    let told: Vec<_> = events.iter().filter(|e| matches!(e, MotionEvent::Triggered { .. })).collect();
    assert_eq!(told.len(), 40);
    let steps = board.bench.steps(0, false);
    for (i, event) in told.iter().enumerate() {
        // 20 steps of play, then 200 to the first pulse, 15 from one to the next.
        let step = steps[20 + 200 + 15 * i - 1].0;
        let pulse = board.bench.timers.camera_pulse().unwrap();
        assert_eq!(pulse, step, "{i}");
        let at = Nanometres(20_000 + 1_500 * i as i32);
        assert_eq!(**event, MotionEvent::Triggered { index: i as u16, time: BoardTime(step / 84), position: at });
    }
}
