//! The controller as a host sees it: what connecting does, hosts that fall silent, the bootloader, and what is refused.

mod motion_model;

use motion_model::Mock;
use parfocal_firmware::controller::{Controller, Link};
use parfocal_firmware::ports::{Identity, Kept, RestingPosition};
use parfocal_protocol::message::*;
use parfocal_protocol::settings::{AxisSettings, BoardSettings};
use parfocal_protocol::units::*;

/// A controller with its board, and hosts that count their requests.
struct Desk {
    controller: Controller<Mock>,
    sequence: u32,
    events: Vec<Event>,
}

impl Desk {
    fn new(kept: &Kept) -> Self {
        let identity = Identity {
            board: Label::new("mock"),
            git: Label::new("test"),
            unique_id: [7; 12],
            boot: 1,
            reset: ResetCause::Power,
            axes: 4,
            can_save: true,
        };
        Self { controller: Controller::new(identity, kept, Mock::new()), sequence: 0, events: Vec::new() }
    }

    fn now(&mut self) -> BoardTime {
        self.controller.board_mut().now()
    }

    fn ask(&mut self, session: u32, request: Request) -> Result<Response, Refusal> {
        self.sequence += 1;
        let now = self.now();
        let message = ToBoard { session: Session(session), sequence: Sequence(self.sequence), request };
        match self.controller.handle(now, Link(0), &message) {
            FromBoard::Reply { result, .. } => result,
            FromBoard::Event { event, .. } => panic!("answered by {event:?}"),
        }
    }

    fn hello(&mut self, session: u32, role: Role) -> Hello {
        match self.ask(session, Request::Hello { role }) {
            Ok(Response::Hello(hello)) => hello,
            other => panic!("{other:?}"),
        }
    }

    fn status(&mut self, session: u32) -> Status {
        match self.ask(session, Request::Status) {
            Ok(Response::Status(status)) => status,
            other => panic!("{other:?}"),
        }
    }

    /// Lets so many ms pass, polled every ms.
    fn run(&mut self, ms: u32) {
        for _ in 0..ms {
            let now = self.now();
            while let Some(FromBoard::Event { event, .. }) = self.controller.poll(now) {
                self.events.push(event);
            }
            self.controller.board_mut().bench.run(84_000);
        }
    }

    fn edges(&mut self) -> usize {
        self.controller.board_mut().bench.changes.len()
    }
}

fn to(um: i32) -> Request {
    Request::Move { to: [Some(Nanometres(um * 1000)), None, None, None], speed: None }
}

#[test]
fn connecting_moves_and_resets_nothing() {
    let mut kept = Kept::default();
    let place = RestingPosition { steps: Steps(6400), known: true };
    kept.position = Some([place; AXES]);
    kept.axes[2] = Some(AxisSettings { inverted: true, ..AxisSettings::default() });
    let mut desk = Desk::new(&kept);
    desk.run(20);
    let before = desk.edges();
    let enabled = desk.controller.board_mut().enabled;
    // Watchers, controllers, one that takes control, goodbyes, and hellos again: on a resting board none of it does anything.
    for (i, role) in [Role::Watch, Role::Control, Role::TakeControl, Role::Watch, Role::Control].into_iter().enumerate()
    {
        let session = 10 + i as u32;
        desk.hello(session, role);
        desk.ask(session, Request::GetBoard).unwrap();
        desk.ask(session, Request::GetAxis { axis: Axis(0) }).unwrap();
        let status = desk.status(session);
        assert!(status.in_position && status.axes.iter().all(|a| a.steps == Steps(6400) && a.trust == Trust::Restored));
        desk.ask(session, Request::Goodbye).unwrap();
        desk.run(10);
    }
    assert_eq!(desk.edges(), before, "no output changed");
    assert_eq!(desk.controller.board_mut().enabled, enabled, "no driver was switched");
}

#[test]
fn a_silent_host_is_lost_and_the_next_hello_says_so() {
    let mut desk = Desk::new(&Kept::default());
    desk.hello(1, Role::Control);
    let settings = BoardSettings { host_timeout: Milliseconds(300), ..BoardSettings::default() };
    desk.ask(1, Request::SetBoard { settings }).unwrap();
    desk.ask(1, to(900)).unwrap();
    desk.hello(2, Role::Watch);
    // One that only watches does not keep the motion of another alive; the one in control does.
    for _ in 0..8 {
        desk.run(50);
        desk.status(1);
    }
    assert_eq!(desk.status(2).stopped, None);
    for _ in 0..14 {
        desk.run(50);
        desk.status(2);
    }
    assert!(desk.events.iter().any(|e| matches!(e, Event::Stopped { cause: StopCause::HostLost, .. })));
    let status = desk.status(2);
    assert!(status.in_position && status.axes[0].trust != Trust::Lost);
    let seen = desk.controller.board_mut().seen(0, false, false);
    assert!(status.axes[0].steps.0 == seen && seen > 0 && seen < 9000, "{seen} {:?}", status.axes[0].steps);
    assert_eq!(desk.hello(3, Role::Watch).last_stop, Some(StopCause::HostLost));
}

#[test]
fn the_bootloader_is_entered_at_rest_only_with_outputs_off_and_an_answer_first() {
    let mut desk = Desk::new(&Kept::default());
    desk.hello(1, Role::Control);
    desk.hello(2, Role::Watch);
    assert_eq!(desk.ask(1, Request::EnterDfu), Err(Refusal::Unsupported), "a board without a bootloader says so");
    desk.controller.board_mut().bootloader = true;
    assert!(matches!(desk.ask(2, Request::EnterDfu), Err(Refusal::NotInControl { .. })));
    desk.ask(1, to(50)).unwrap();
    desk.run(20);
    assert_eq!(desk.ask(1, Request::EnterDfu), Err(Refusal::Busy));
    desk.run(1000);
    assert!(desk.status(1).in_position);
    let edges = desk.edges();
    assert_eq!(desk.ask(1, Request::EnterDfu), Ok(Response::Done));
    assert!(!desk.controller.board_mut().on, "outputs are off with the answer");
    assert!(!desk.controller.board_mut().entered, "the answer goes out first");
    assert_eq!(desk.ask(1, to(0)), Err(Refusal::Busy), "nothing is begun any more");
    desk.run(60);
    assert!(desk.controller.board_mut().entered && desk.edges() == edges);
}

#[test]
fn impossible_motions_are_refused_when_asked_for_with_field_and_range() {
    let mut desk = Desk::new(&Kept::default());
    desk.hello(1, Role::Control);
    // A4988: a pulse of 1 µs and 1 µs of pause at 10 steps/µm bound the speed by about 49,000 µm/s.
    let settings = AxisSettings { speed: MicrometresPerSecond(60_000.0), ..AxisSettings::default() };
    let refusal = desk.ask(1, Request::SetAxis { axis: Axis(0), settings }).unwrap_err();
    let Refusal::OutOfRange { field: Field::Speed, high, .. } = refusal else { panic!("{refusal:?}") };
    assert!((high - 84e6 / 170.0 / 10.0).abs() < 100.0, "{high}");
    // Four axes at 400,000 steps/s each fit the timers, one by one, and not the DMA together: the line is slower, a faster
    // one is refused.
    let settings = AxisSettings {
        steps_per_um: StepsPerMicrometre(400.0),
        speed: MicrometresPerSecond(1500.0),
        driver: parfocal_protocol::settings::Driver::Tmc2209,
        ..AxisSettings::default()
    };
    for axis in 0..4 {
        desk.ask(1, Request::SetAxis { axis: Axis(axis), settings }).unwrap();
    }
    let line =
        |speed| Request::Move { to: [Some(Nanometres(500_000)); AXES], speed: Some(MicrometresPerSecond(speed)) };
    let refusal = desk.ask(1, line(3000.0)).unwrap_err();
    let Refusal::OutOfRange { field: Field::Speed, high, .. } = refusal else { panic!("{refusal:?}") };
    assert!(high < 3000.0);
    // At the very bound it goes, and every axis arrives.
    desk.ask(1, line(high)).unwrap();
    desk.run(1500);
    let status = desk.status(1);
    assert!(status.in_position && status.stopped.is_none(), "{:?}", status.stopped);
    assert!(status.axes.iter().all(|a| a.steps == Steps(200_000)));
    for speed in [0.0, -5.0, f32::NAN, f32::INFINITY] {
        assert!(desk.ask(1, line(speed)).is_err(), "{speed}");
    }
    let beyond = desk.ask(1, to(2000)).unwrap_err();
    assert!(matches!(beyond, Refusal::BeyondLimit { axis: Axis(0), .. }), "{beyond:?}");
}

#[test]
fn telemetry_tells_where_the_axes_are_at_its_rate() {
    let mut desk = Desk::new(&Kept::default());
    desk.hello(1, Role::Control);
    desk.ask(1, to(500)).unwrap();
    desk.run(400);
    let told: Vec<(u64, i32)> = desk
        .events
        .iter()
        .filter_map(|e| match e {
            Event::Position { time, steps } => Some((time.0, steps[0].0)),
            _ => None,
        })
        .collect();
    assert!(told.len() >= 39, "{} in 400 ms of motion", told.len());
    assert!(told.windows(2).all(|w| w[1].0 - w[0].0 <= 11_000 && w[1].1 >= w[0].1));
}
