//! The board's decisions: `handle` a request, `poll` for what happens by itself. No clock, no hardware of its own.

use crate::focusing::Focusing;
use crate::motion::{Ending, Motion, MotionEvent};
use crate::parking::Parking;
use crate::ports::{Board, Identity, Kept};
use crate::sessions::{Answer, Arrival, Sessions};
use parfocal_protocol::SCHEMA;
use parfocal_protocol::message::{
    Event, Field, FromBoard, Hello, MotionId, Refusal, Request, Response, Role, Session, Status, Stop, StopCause,
    ToBoard,
};
use parfocal_protocol::settings::BoardSettings;
use parfocal_protocol::units::{Axis, BoardTime, Hertz, Milliseconds};

/// A way in and out of the board, by number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Link(pub u8);

/// Axes' speeds and host timeouts that a board accepts.
const HOST_TIMEOUT_MS: core::ops::RangeInclusive<u32> = 100..=60_000;
const TELEMETRY_HZ: core::ops::RangeInclusive<f32> = 0.0..=1000.0;

/// Everything that a board knows and decides, above its hardware `B`.
#[derive(Debug)]
pub struct Controller<B> {
    board: B,
    identity: Identity,
    settings: BoardSettings,
    motion: Motion,
    focusing: Focusing,
    sessions: Sessions,
    parking: Parking,
    last_stop: Option<StopCause>,
    told: Option<BoardTime>,
    events: u32,
    /// When to restart into the bootloader.
    leaving: Option<BoardTime>,
}

/// From the answer to a request for the bootloader to the restart, µs: the answer is on its way by then.
const LEAVE_US: u64 = 50_000;

impl<B: Board> Controller<B> {
    /// A board that has just started, with what it kept. Nothing moves.
    pub fn new(identity: Identity, kept: &Kept, mut board: B) -> Self {
        let mut motion = Motion::new();
        for (i, settings) in kept.axes.iter().enumerate() {
            // Settings that an older firmware allowed and this one does not: the defaults hold, and a status shows them.
            let settings = settings.unwrap_or_default();
            let _ = motion.configure(&mut board, Axis(i as u8), &settings);
        }
        let settings = kept.board.unwrap_or_default();
        motion.set_emergency_wired(settings.has_emergency_stop);
        let parking = Parking::restore(&mut motion, &mut board, kept.position.as_ref());
        Self {
            board,
            identity,
            settings,
            motion,
            focusing: Focusing::new(),
            sessions: Sessions::new(),
            parking,
            last_stop: None,
            told: None,
            events: 0,
            leaving: None,
        }
    }

    /// The hardware, for the simulator and tests.
    pub fn board_mut(&mut self) -> &mut B {
        &mut self.board
    }

    /// Carries out one request, or begins to; the answer goes back on the link that it came from.
    pub fn handle(&mut self, now: BoardTime, link: Link, message: &ToBoard) -> FromBoard {
        let ToBoard { session, sequence, request } = *message;
        let result = match (self.sessions.arrive(now, link, session, sequence), request) {
            // Never too late, and harmless to repeat: whoever sees something go wrong may say it.
            (_, Request::Stop { how }) => {
                self.stop(now, how);
                Ok(Response::Done)
            }
            // Number 0 asks who the board is without counting: after a broken connection.
            (_, Request::Hello { role }) if sequence.0 == 0 => Ok(self.hello(now, link, session, role)),
            (Arrival::Unknown, Request::Hello { role }) => {
                let answer = Ok(self.hello(now, link, session, role));
                self.sessions.answered(session, sequence, answer);
                answer
            }
            (Arrival::Unknown, _) => Err(Refusal::NoSession),
            (Arrival::Old, _) => Err(Refusal::OldSequence),
            (Arrival::Again(answer), _) => answer,
            (Arrival::New, request) => {
                let answer = self.carry_out(now, link, session, request);
                self.sessions.answered(session, sequence, answer);
                answer
            }
        };
        FromBoard::Reply { session, sequence, result }
    }

    /// What happens by itself. Call it until it gives nothing, at least every millisecond while something moves.
    /// Events go to every link that has a session.
    pub fn poll(&mut self, now: BoardTime) -> Option<FromBoard> {
        self.watch_host(now);
        if self.leaving.is_some_and(|since| now.since(since) >= LEAVE_US) {
            self.board.enter_bootloader();
            self.leaving = None;
        }
        let event = self.motion_event(now).or_else(|| self.scan_event(now)).or_else(|| self.telemetry(now));
        self.parking.poll(now, &self.motion, &mut self.board);
        event.map(|event| {
            let count = self.events;
            self.events = self.events.wrapping_add(1);
            FromBoard::Event { count, event }
        })
    }

    /// Whether anything is under way that wants a poll every millisecond.
    pub fn is_busy(&self) -> bool {
        !self.motion.in_position() || self.focusing.is_running()
    }

    fn carry_out(&mut self, now: BoardTime, link: Link, session: Session, request: Request) -> Answer {
        if needs_control(&request) && self.sessions.controller() != session {
            return Err(Refusal::NotInControl { controller: self.sessions.controller() });
        }
        if is_motion(&request) && (self.focusing.is_running() || self.leaving.is_some()) {
            return Err(Refusal::Busy);
        }
        if is_motion(&request) {
            self.parking.leave(&mut self.board);
        }
        let axes = self.identity.axes;
        let existing = |axis: Axis| if axis.0 < axes { Ok(axis) } else { Err(Refusal::NoSuchAxis { axis }) };
        let (motion, board) = (&mut self.motion, &mut self.board);
        let moving = |motion: MotionId| Response::Moving { motion };
        let done = |()| Response::Done;
        match request {
            Request::Hello { role } => Ok(self.hello(now, link, session, role)),
            Request::Goodbye => {
                self.sessions.release(session);
                Ok(Response::Done)
            }
            Request::Status => Ok(Response::Status(self.status(now))),
            Request::Move { to, speed } => motion.move_to(now, board, &to, speed, Ending::Approach).map(moving),
            Request::Jog { axis, speed } => motion.jog(now, board, axis, speed).map(moving),
            Request::Vibrate { axis, amplitude, frequency, cycles } => {
                motion.vibrate(now, board, axis, amplitude, frequency, cycles).map(moving)
            }
            Request::Home { axis } => motion.home(now, board, axis).map(moving),
            Request::Stop { how } => {
                self.stop(now, how);
                Ok(Response::Done)
            }
            Request::Hold => {
                motion.hold(now, board);
                Ok(Response::Done)
            }
            Request::Resume => {
                motion.resume();
                Ok(Response::Done)
            }
            Request::GetAxis { axis } => Ok(Response::Axis(*motion.settings(existing(axis)?))),
            Request::SetAxis { axis, settings } => motion.configure(board, existing(axis)?, &settings).map(done),
            Request::GetBoard => Ok(Response::Board(self.settings)),
            Request::SetBoard { settings } => self.set_board(settings).map(done),
            Request::Save => self.parking.save(&self.motion, &self.settings, &mut self.board).map(done),
            Request::SetPosition { axis, at } => motion.set_position(board, axis, at).map(done),
            Request::Enable { axis, on } => motion.enable(board, axis, on).map(done),
            Request::ClearEmergency => motion.clear_emergency(now, board).map(done),
            Request::Trigger { plan } => motion.trigger(board, &plan).map(done),
            Request::AutofocusStart(parameters) => {
                existing(parameters.axis)?;
                if self.leaving.is_some() {
                    return Err(Refusal::Busy);
                }
                self.parking.leave(board);
                self.focusing.start(now, &parameters, motion, board).map(Response::Scan)
            }
            Request::AutofocusSample(sample) => self.focusing.sample(now, &sample, motion, board).map(Response::Scan),
            Request::AutofocusSweepSample(sample) => {
                let swept = self.focusing.sweep_sample(now, &sample, motion, board);
                swept.map(|(z, state)| Response::Swept { z, state })
            }
            Request::AutofocusState => Ok(Response::Scan(self.focusing.state())),
            Request::AutofocusAbort { scan } => self.focusing.abort(now, scan, motion, board).map(Response::Scan),
            Request::Clock { sent } => Ok(Response::Clock { sent, received: now, answered: now }),
            Request::EnterDfu => {
                if !self.motion.in_position() || self.focusing.is_running() {
                    return Err(Refusal::Busy);
                }
                if !self.board.has_bootloader() {
                    return Err(Refusal::Unsupported);
                }
                // Nothing moves from here on.
                self.board.outputs_off();
                self.leaving = Some(now);
                Ok(Response::Done)
            }
        }
    }

    fn hello(&mut self, now: BoardTime, link: Link, session: Session, asked: Role) -> Response {
        let before = self.sessions.controller();
        let role = self.sessions.open(now, link, session, asked);
        if asked == Role::TakeControl && before != session && before != Session(0) {
            self.end(now, StopCause::ControlTaken);
        }
        let text = |s: Option<&str>| s.and_then(|s| s.parse().ok()).unwrap_or(0);
        Response::Hello(Hello {
            schema: SCHEMA,
            firmware: [
                text(option_env!("CARGO_PKG_VERSION_MAJOR")),
                text(option_env!("CARGO_PKG_VERSION_MINOR")),
                text(option_env!("CARGO_PKG_VERSION_PATCH")),
            ],
            git: self.identity.git,
            board: self.identity.board,
            unique_id: self.identity.unique_id,
            boot: self.identity.boot,
            reset: self.identity.reset,
            axes: self.identity.axes,
            role,
            can_save: self.identity.can_save,
            last_stop: self.last_stop,
        })
    }

    fn status(&mut self, now: BoardTime) -> Status {
        let axes = core::array::from_fn(|i| self.motion.status(&mut self.board, Axis(i as u8)));
        Status {
            time: now,
            axes,
            motion: self.motion.motion(),
            in_position: self.motion.in_position(),
            held: self.motion.held(),
            stopped: self.motion.stopped(),
            emergency: self.motion.emergency_in_force(),
            controller: self.sessions.controller(),
            scan: self.focusing.state(),
        }
    }

    fn set_board(&mut self, settings: BoardSettings) -> Result<(), Refusal> {
        let BoardSettings { host_timeout: Milliseconds(timeout), telemetry: Hertz(rate), .. } = settings;
        if !HOST_TIMEOUT_MS.contains(&timeout) {
            let (low, high) = (*HOST_TIMEOUT_MS.start() as f32, *HOST_TIMEOUT_MS.end() as f32);
            return Err(Refusal::OutOfRange { field: Field::HostTimeout, low, high });
        }
        if !TELEMETRY_HZ.contains(&rate) {
            let (low, high) = (*TELEMETRY_HZ.start(), *TELEMETRY_HZ.end());
            return Err(Refusal::OutOfRange { field: Field::Telemetry, low, high });
        }
        self.motion.set_emergency_wired(settings.has_emergency_stop);
        self.settings = settings;
        Ok(())
    }

    fn stop(&mut self, now: BoardTime, how: Stop) {
        match how {
            Stop::Decelerate => self.end(now, StopCause::Asked),
            Stop::Emergency => {
                self.last_stop = Some(StopCause::Emergency);
                self.focusing.interrupted();
                self.motion.emergency(now, &mut self.board);
            }
        }
    }

    /// Stops all motion, decelerated. A scan that was running ends where it is: going back would be motion again.
    fn end(&mut self, now: BoardTime, cause: StopCause) {
        if self.is_busy() {
            self.last_stop = Some(cause);
        }
        self.focusing.interrupted();
        self.motion.stop(now, &mut self.board, cause);
    }

    /// A host that fell silent in the middle of something is a host that no longer watches.
    fn watch_host(&mut self, now: BoardTime) {
        if !self.is_busy() || self.motion.stopped().is_some() {
            return;
        }
        let limit = u64::from(self.settings.host_timeout.0) * 1000;
        if self.sessions.controller_heard().is_some_and(|heard| now.since(heard) > limit) {
            self.end(now, StopCause::HostLost);
        }
    }

    fn motion_event(&mut self, now: BoardTime) -> Option<Event> {
        Some(match self.motion.poll(now, &mut self.board)? {
            MotionEvent::InPosition(motion) => Event::InPosition { motion },
            MotionEvent::Stopped { motion, cause } => {
                if cause != StopCause::Asked {
                    self.last_stop = Some(cause);
                }
                self.focusing.stopped(cause);
                Event::Stopped { motion, cause }
            }
            MotionEvent::Triggered { index, time, position } => Event::Triggered { index, time, position },
            MotionEvent::EmergencyInput { pressed } => {
                if pressed {
                    self.last_stop = Some(StopCause::Emergency);
                    self.focusing.interrupted();
                }
                Event::EmergencyInput { pressed }
            }
        })
    }

    /// Whether a scan has something to work out: [`Controller::poll`] is wanted at once.
    pub fn is_thinking(&self) -> bool {
        self.focusing.is_thinking()
    }

    fn scan_event(&mut self, now: BoardTime) -> Option<Event> {
        self.focusing.poll(now, &mut self.motion, &mut self.board)
    }

    fn telemetry(&mut self, now: BoardTime) -> Option<Event> {
        let Hertz(rate) = self.settings.telemetry;
        if self.motion.in_position() || rate <= 0.0 {
            self.told = None;
            return None;
        }
        let every = (1e6 / rate) as u64;
        let since = self.told.map(|told| now.since(told));
        if since.is_some_and(|since| since < every) {
            return None;
        }
        // In step with its rate, however late this look is; but never a burst to catch up.
        let late = since.map_or(0, |since| since - every);
        self.told = Some(if late < every { BoardTime(now.0 - late) } else { now });
        Some(Event::Position { time: now, steps: self.motion.steps(&mut self.board) })
    }
}

/// Requests that only the session in control may make.
fn needs_control(request: &Request) -> bool {
    !matches!(
        request,
        Request::Hello { .. }
            | Request::Status
            | Request::Stop { .. }
            | Request::GetAxis { .. }
            | Request::GetBoard
            | Request::AutofocusState
            | Request::Clock { .. }
            | Request::Goodbye
    )
}

/// Requests that begin a motion of their own.
fn is_motion(request: &Request) -> bool {
    matches!(request, Request::Move { .. } | Request::Jog { .. } | Request::Vibrate { .. } | Request::Home { .. })
}
