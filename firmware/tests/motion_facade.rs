//! Motion as the controller sees it, down to the edges.

mod motion_model;

use motion_model::Mock;
use parfocal_firmware::motion::{Motion, MotionEvent};
use parfocal_protocol::message::{Refusal, StopCause, Trust};
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
    let id = motion.move_to(board.now(), &mut board, &to, None).unwrap();
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
        motion.move_to(board.now(), &mut board, &[Some(Nanometres(um * 1000)), None, None, None], None).unwrap();
        let events = board.run(&mut motion, 5000, over);
        assert_eq!(events.len(), 1);
        assert_eq!(motion.status(&mut board, Axis(0)).position, Nanometres(um * 1000));
        assert_eq!(board.bench.steps(0, false).last().unwrap().1, true);
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
        .move_to(board.now(), &mut board, &[Some(Nanometres(500_000)), Some(Nanometres(700_000)), None, None], None)
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
    motion.move_to(board.now(), &mut board, &[Some(Nanometres(500_000)), None, None, None], None).unwrap();
    board.run(&mut motion, 200, |_| false);
    board.bench.pass(1234);
    motion.emergency(board.now(), &mut board);
    assert_eq!(motion.steps(&mut board)[0].0, board.seen(0, false, false));
    assert_eq!(motion.status(&mut board, Axis(0)).trust, Trust::Lost);
    motion.clear_emergency(board.now(), &mut board).unwrap();
    board.bench.changes.clear();
    let before = motion.steps(&mut board)[0].0;
    motion.move_to(board.now(), &mut board, &[Some(Nanometres(0)), None, None, None], None).unwrap();
    board.run(&mut motion, 5000, over);
    assert_eq!(motion.steps(&mut board)[0].0, 0);
    assert_eq!(board.seen(0, false, false), -before);
}
