//! The thread that moves things: it alone drives the boards, one order after another.

use super::calibrating::Calibration;
use super::desk::{Desk, Doing, Level};
use super::focusing::Scan;
use super::jog::Watchdog;
use super::order::{Answer, Envelope, Order, OrderError, STALE_MS};
use super::places;
use super::turret::put_in_use;
use crate::link::LinkError;
use crate::link::explain::Explained;
use crate::link::transport::{later, real_now};
use crate::procedure::Guard;
use crate::rig::AxisName;
use crate::stage::{Stage, status};
use parfocal_protocol::message::{MotionId, Request};
use parfocal_protocol::units::{HostTime, Micrometres, MicrometresPerSecond};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError};

/// Time given to each board's messages in a turn, ms.
const TURN_MS: u64 = 3;
/// While something moves the boards hear of this program at least this often, ms: they stop for a host that is lost.
const HEARD_MS: u64 = 200;

/// The thread's own.
pub struct Driver {
    desk: Arc<Desk>,
    stage: Stage,
    dog: Watchdog,
    moving: Option<Moving>,
    heard: HostTime,
}

/// What an order began.
struct Begun {
    id: u64,
    rest: Option<Rest>,
}

/// What the thread does to the end, once who asked has been answered.
enum Rest {
    Scan(Scan),
    Calibration(Calibration),
}

impl Begun {
    fn wholly(id: u64) -> Self {
        Self { id, rest: None }
    }
}

/// A move under way.
struct Moving {
    motions: Vec<(usize, MotionId)>,
    halts: u64,
}

impl Driver {
    /// Starts the thread. It ends with [`Desk::close`] or when nobody can give orders any more.
    pub fn start(desk: Arc<Desk>, stage: Stage, orders: Receiver<Envelope>) -> std::thread::JoinHandle<()> {
        let mut driver = Self { desk, stage, dog: Watchdog::default(), moving: None, heard: HostTime(0) };
        std::thread::spawn(move || {
            while !driver.desk.ending() && driver.turn(&orders) {}
            driver.let_go();
            driver.stage.stop(parfocal_protocol::message::Stop::Decelerate);
            driver.stage.close();
        })
    }

    /// One turn of the thread's loop; false when nobody can give orders any more.
    fn turn(&mut self, orders: &Receiver<Envelope>) -> bool {
        loop {
            match orders.try_recv() {
                Ok(envelope) => {
                    let late = real_now() >= later(envelope.at, STALE_MS);
                    let begun = if late { Err(OrderError::Stale) } else { self.carry_out(envelope.order) };
                    let (answer, rest) = match begun {
                        Ok(Begun { id, rest }) => (Ok(id), rest),
                        Err(error) => (Err(error), None),
                    };
                    // Who asked may be gone.
                    let _ = envelope.answer.send(answer);
                    match rest {
                        Some(Rest::Scan(scan)) => scan.run(&self.desk, &mut self.stage),
                        Some(Rest::Calibration(calibration)) => calibration.run(&self.desk, &mut self.stage),
                        None => {}
                    }
                }
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => return false,
            }
        }
        for axis in self.dog.expired(real_now()) {
            self.end_jog(axis);
        }
        match self.listen() {
            Ok(()) => *self.desk.link_problem() = None,
            Err(error) => self.lost(&error),
        }
        self.look();
        true
    }

    /// Hears what the boards say, and lets them hear of us.
    fn listen(&mut self) -> Result<(), LinkError> {
        let busy = self.moving.is_some() || self.dog.any();
        let speak = busy && real_now() >= later(self.heard, HEARD_MS);
        if speak {
            self.heard = real_now();
        }
        for link in self.stage.boards_mut() {
            if speak {
                status(link)?;
            }
            let until = later(link.now(), TURN_MS);
            while link.event(until)?.is_some() {}
        }
        Ok(())
    }

    fn lost(&mut self, error: &LinkError) {
        let text = error.to_string();
        let new = self.desk.link_problem().replace(text.clone()).as_ref() != Some(&text);
        if new {
            self.desk.tell(Level::Error, text.clone());
        }
        self.dog.let_go();
        if self.moving.take().is_some() || self.desk.activity().doing != Doing::Idle {
            self.desk.end(false, text);
        }
        std::thread::sleep(std::time::Duration::from_millis(100));
    }

    /// Whether what goes on is over.
    fn look(&mut self) {
        let doing = self.desk.activity().doing;
        match (&self.moving, doing) {
            (Some(moving), _) => {
                let stopped = moving.halts != self.desk.halts();
                let ends: Option<Vec<_>> =
                    moving.motions.iter().map(|(board, motion)| self.over(*board, *motion)).collect();
                if let Some(ends) = ends {
                    self.moving = None;
                    match ends.into_iter().flatten().next() {
                        Some(why) => self.desk.end(false, format!("the move ended early: {why}")),
                        None if stopped => self.desk.end(false, "the move was stopped"),
                        None => self.desk.end(true, "in position"),
                    }
                }
            }
            (None, Doing::Jog) if !self.dog.any() => {
                let resting = |i: usize| self.desk.watchers[i].heard().is_some_and(|h| h.status.in_position);
                if (0..self.desk.watchers.len()).all(resting) {
                    self.desk.end(true, "the jog ended");
                }
            }
            _ => {}
        }
    }

    /// Whether a motion is over, and if it ended early, why.
    fn over(&self, board: usize, motion: MotionId) -> Option<Option<String>> {
        let status = self.desk.watchers.get(board)?.heard()?.status;
        if status.motion > motion {
            return Some(None);
        }
        match status.stopped {
            _ if status.motion < motion || !status.in_position => None,
            Some(cause) => Some(Some(Explained(&cause).to_string())),
            None => Some(None),
        }
    }

    fn carry_out(&mut self, order: Order) -> Result<Begun, OrderError> {
        match order {
            Order::Jog { axis, speed } => return self.jog(axis, speed).map(Begun::wholly),
            Order::LetGo => {
                self.let_go();
                return Ok(Begun::wholly(self.desk.activity().id));
            }
            _ => {}
        }
        let activity = self.desk.activity().clone();
        if activity.doing != Doing::Idle {
            return Err(OrderError::Busy(activity.text));
        }
        let id = match order {
            Order::Move { to, relative, speed } => {
                let to = if relative { self.absolute(&to)? } else { to };
                self.go(&to, speed)
            }
            Order::Click { device, at } => {
                let to = places::targets(&self.desk, device, at)?;
                self.go(&to, None)
            }
            Order::Autofocus(focus) => {
                let scan = Scan::begin(&self.desk, &mut self.stage, &focus)?;
                return Ok(Begun { id: scan.id(), rest: Some(Rest::Scan(scan)) });
            }
            Order::Calibrate(plan) => {
                let calibration = Calibration::begin(&self.desk, plan);
                return Ok(Begun { id: calibration.id(), rest: Some(Rest::Calibration(calibration)) });
            }
            Order::Objective { name, new } => {
                put_in_use(&self.desk, &name, new)?;
                Ok(activity.id)
            }
            Order::ClearEmergency => {
                for link in self.stage.boards_mut() {
                    link.request(Request::ClearEmergency)?;
                }
                self.desk.tell(Level::Info, "the emergency stop is released: home the axes, or set their positions");
                Ok(activity.id)
            }
            Order::Jog { .. } | Order::LetGo => Ok(activity.id),
        };
        id.map(Begun::wholly)
    }

    fn absolute(&mut self, by: &[(AxisName, Micrometres)]) -> Result<Vec<(AxisName, Micrometres)>, OrderError> {
        let at = |(axis, by): &(AxisName, Micrometres)| Ok((*axis, Micrometres(self.stage.position(*axis)?.0 + by.0)));
        by.iter().map(at).collect()
    }

    fn go(&mut self, to: &[(AxisName, Micrometres)], speed: Option<MicrometresPerSecond>) -> Answer {
        let halts = self.desk.halts();
        let rig = self.desk.rig().clone();
        let keep_on = || self.desk.halts() == halts;
        // Every tip on its whole way against every obstacle, before anything moves.
        Guard::new(&mut self.stage, &rig, &keep_on).check(to)?;
        let motions = self.stage.begin(to, speed)?;
        // A STOP that came between the boards' answers.
        if self.desk.halts() != halts {
            self.stage.stop(parfocal_protocol::message::Stop::Decelerate);
        }
        self.heard = real_now();
        let places: Vec<_> = to.iter().map(|(axis, at)| format!("{axis} to {:.2} µm", at.0)).collect();
        let id = self.desk.begin(Doing::Move, format!("moving {}", places.join(", ")));
        self.moving = Some(Moving { motions, halts });
        Ok(id)
    }

    fn jog(&mut self, axis: AxisName, speed: MicrometresPerSecond) -> Answer {
        let activity = self.desk.activity().clone();
        if !matches!(activity.doing, Doing::Idle | Doing::Jog) {
            return Err(OrderError::Busy(activity.text));
        }
        if speed.0 == 0.0 {
            if self.dog.ask(real_now(), axis, speed) {
                self.end_jog(axis);
            }
            return Ok(activity.id);
        }
        if self.dog.ask(real_now(), axis, speed) {
            let (link, number) = self.stage.find(axis)?;
            if let Err(error) = link.request(Request::Jog { axis: number, speed }) {
                self.dog.ask(real_now(), axis, MicrometresPerSecond(0.0));
                return Err(error.into());
            }
            self.heard = real_now();
        }
        if activity.doing == Doing::Idle {
            return Ok(self.desk.begin(Doing::Jog, format!("{axis} is jogged")));
        }
        Ok(activity.id)
    }

    fn end_jog(&mut self, axis: AxisName) {
        let ended = self
            .stage
            .find(axis)
            .map(|(link, number)| link.request(Request::Jog { axis: number, speed: MicrometresPerSecond(0.0) }));
        // A board that refuses rests already, after a STOP or at its limit.
        if let Ok(Err(error)) = ended
            && !matches!(error, LinkError::Refused(_))
        {
            self.lost(&error);
        }
    }

    fn let_go(&mut self) {
        for axis in self.dog.let_go() {
            self.end_jog(axis);
        }
    }
}
