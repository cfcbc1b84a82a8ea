//! Moves: planned here, handed to the engine, stopped and held.

use super::engine::TICKS_PER_US;
use super::facade::{Known, Leg, Motion, MotionEvent, Task, Wish};
use super::homing::Homing;
use super::lane::Lane;
use super::limits::{self, RECORDS_PER_SECOND, TICKS};
use super::math::sqrt;
use super::path::{Limits, Path, State};
use super::swing::Swinging;
use crate::ports::Board;
use heapless::Vec;
use parfocal_protocol::message::{Field, MotionId, Refusal, StopCause, Trust};
use parfocal_protocol::settings::Side;
use parfocal_protocol::units::{
    AXES, Axis, BoardTime, Hertz, MicrometresPerSecond, Nanometres, PerAxis, StepsPerMicrometre,
};

/// Between the records laid and the tick at which a changed path may begin, ticks: time to plan it, 0.5 ms.
const PLANNING: u64 = 500 * TICKS_PER_US;

/// Between the records laid and the first path from rest, ticks: DIR's setup fits in.
const BEGINNING: u64 = 2_000;

/// A straight line for several axes at once.
struct Straight {
    path: Path,
    limits: Limits,
}

impl Motion {
    /// Moves in a straight line to absolute positions, behind the moves that wait already.
    ///
    /// # Errors
    /// [`Refusal::BeyondLimit`], [`Refusal::OutOfRange`] for a speed that is too slow or more than the axes allow along this
    /// line, [`Refusal::AtHardLimit`], [`Refusal::QueueFull`], [`Refusal::Emergency`], [`Refusal::Busy`] while something
    /// other than moves goes on.
    pub fn move_to(
        &mut self,
        now: BoardTime,
        board: &mut impl Board,
        to: &PerAxis<Option<Nanometres>>,
        speed: Option<MicrometresPerSecond>,
    ) -> Result<MotionId, Refusal> {
        let waits = match &self.task {
            _ if self.emergency => return Err(Refusal::Emergency),
            Task::Rest => !self.queue.is_empty() || self.held,
            Task::Line { .. } if self.stopping.is_none() || self.held => true,
            _ => return Err(Refusal::Busy),
        };
        if self.queue.is_full() {
            return Err(Refusal::QueueFull);
        }
        for (index, to) in to.iter().enumerate() {
            if let Some(to) = to {
                self.allowed(index, *to)?;
            }
        }
        // Where this move will begin: behind the last that waits.
        let mut from = self.targets(board);
        for wish in self.queue.iter() {
            from = core::array::from_fn(|i| wish.to[i].map_or(from[i], |to| self.scale(i).steps(to).0));
        }
        let goal: Leg = core::array::from_fn(|i| to[i].map(|to| self.scale(i).steps(to).0));
        for (index, goal) in goal.iter().enumerate() {
            let side = if goal.is_some_and(|g| g > from[index]) { Side::High } else { Side::Low };
            if goal.is_some_and(|g| g != from[index]) && !waits && self.pressed(index, side) {
                return Err(Refusal::AtHardLimit { axis: Axis(index as u8), side });
            }
        }
        self.straight(&from, &goal, speed)?;
        let id = self.next_id();
        let wish = Wish { id, to: *to, speed };
        let _ = self.queue.push_back(wish);
        if !waits {
            self.next_move(now, board);
        }
        Ok(id)
    }

    /// Begins the first move that waits.
    pub(super) fn next_move(&mut self, now: BoardTime, board: &mut impl Board) {
        let Some(wish) = self.queue.pop_front() else { return };
        self.track_play(board);
        let mut take_up: Leg = [None; AXES];
        let (mut main, mut approach) = (take_up, take_up);
        let mut beyond = 0.0f64;
        for index in 0..AXES {
            let Some(to) = wish.to[index] else { continue };
            let known = self.known(index);
            let scale = f64::from(known.settings.steps_per_um.0);
            let from = known.seen.wrapping_sub(known.play.slack);
            let to = known.settings.steps_per_um.steps(to).0;
            let overshoot = (super::backlash::OVERSHOOT_UM * scale + 0.5) as i32 + known.play.width;
            let legs = known.play.legs(from, to, known.settings.approach, overshoot);
            (take_up[index], main[index], approach[index]) = (legs.take_up, legs.main, legs.approach);
            if legs.approach.is_some() {
                let far = f64::from(overshoot) / scale;
                beyond += 4.0 * far * far;
            }
        }
        self.approach_um = sqrt(beyond) as f32;
        let mut legs: Vec<Leg, 3> = Vec::new();
        for leg in [approach, main, take_up] {
            if leg.iter().any(Option::is_some) {
                let _ = legs.push(leg);
            }
        }
        self.running = wish.id;
        self.stopped = None;
        let first = legs.pop().unwrap_or_default();
        let then = legs.iter().copied().collect();
        self.task = Task::Line { wish, now: first, then };
        self.begin_leg(now, board);
    }

    /// Starts the axes of the leg that is due.
    pub(super) fn begin_leg(&mut self, now: BoardTime, board: &mut impl Board) {
        self.quiet = None;
        let Task::Line { wish, now: leg, .. } = &self.task else { return };
        let (leg, speed) = (*leg, wish.speed);
        self.track_play(board);
        let from: [i32; AXES] = core::array::from_fn(|i| self.known(i).seen);
        // Refused when asked for; a plan that fails here begins nothing and so ends at once.
        let fastest = self.straight(&from, &leg, None);
        let Ok(straight) = self.straight(&from, &leg, speed).or(fastest) else { return };
        for (index, from) in from.into_iter().enumerate() {
            let Some(to) = leg[index].filter(|to| *to != from) else { continue };
            let distance = f64::from(to.wrapping_sub(from));
            self.set_lane(index, straight.path.clone(), distance, straight.limits);
        }
        self.launch(now, board);
    }

    /// An axis' next lane, from rest; its beginning is set by [`Self::launch`].
    pub(super) fn set_lane(&mut self, index: usize, path: Path, scale: f64, limits: Limits) {
        let known = self.known_mut(index);
        known.past = known.lane.take();
        known.lane = Some(Lane {
            begin: u64::MAX,
            path,
            scale: if scale < 0.0 { -scale } else { scale },
            up: scale > 0.0,
            base: known.seen,
            offset: 0.0,
            limits,
            play: known.play,
        });
    }

    /// Hands all lanes that have not begun to the engine, to begin together.
    pub(super) fn launch(&mut self, now: BoardTime, board: &mut impl Board) {
        let _ = now;
        self.quiet = None;
        let mut phases: [super::lane::Phases; AXES] = Default::default();
        for (index, phases) in phases.iter_mut().enumerate() {
            let known = self.known_mut(index);
            if let Some(lane) = known.lane.as_mut().filter(|l| l.begin == u64::MAX) {
                lane.begin = 0;
                *phases = lane.phases();
                lane.begin = u64::MAX;
                if !known.enabled {
                    known.enabled = true;
                    board.enable(index, true);
                }
            }
        }
        let begin = board.pulses(|engine| {
            let begin = engine.laid([true; AXES]) + BEGINNING;
            for (index, phases) in phases.iter_mut().enumerate() {
                phases.iter_mut().for_each(|p| p.begin += begin);
                engine.append(index, phases);
            }
            begin
        });
        for known in &mut self.axes {
            if let Some(lane) = known.lane.as_mut().filter(|l| l.begin == u64::MAX) {
                lane.begin = begin;
            }
        }
    }

    /// A line between motor counts. Distance 1 is all of it.
    fn straight(&self, from: &[i32; AXES], to: &Leg, speed: Option<MicrometresPerSecond>) -> Result<Straight, Refusal> {
        let steps: [f64; AXES] =
            core::array::from_fn(|i| to[i].map_or(0.0, |to| (f64::from(to) - f64::from(from[i])).abs()));
        let mut square = 0.0;
        for (index, steps) in steps.iter().enumerate() {
            let um = steps / f64::from(self.scale(index).0);
            square += um * um;
        }
        let length = sqrt(square);
        let asked = speed.map(|s| f64::from(s.0));
        if asked.is_some_and(|s| !s.is_finite()) {
            return Err(Refusal::NotANumber);
        }
        if length == 0.0 {
            return match asked {
                Some(s) if s <= 0.0 => Err(Refusal::OutOfRange { field: Field::Speed, low: 0.0, high: f32::MAX }),
                _ => Ok(Straight { path: Path::default(), limits: Limits { v: 1.0, a: 1.0, j: 1.0 } }),
            };
        }
        let mut limits = Limits { v: f64::MAX, a: f64::MAX, j: f64::MAX };
        let (mut records, mut most) = (0.0, 0.0f64);
        for (known, steps) in self.axes.iter().zip(steps).filter(|(_, s)| *s > 0.0) {
            let own = limits::in_ticks(&known.settings);
            limits.v = limits.v.min(own.v / steps);
            limits.a = limits.a.min(own.a / steps);
            limits.j = limits.j.min(own.j / steps);
            records += limits::records(&known.settings, steps);
            most = most.max(steps);
        }
        limits.v = limits.v.min(RECORDS_PER_SECOND / TICKS / records);
        if let Some(asked) = asked {
            let v = asked / length / TICKS;
            let slowest = limits::SLOWEST / TICKS / most;
            if !(v >= slowest && v <= limits.v * 1.000_001) {
                let um_s = length * TICKS;
                let (low, high) = ((slowest * um_s) as f32, (limits.v * um_s) as f32);
                return Err(Refusal::OutOfRange { field: Field::Speed, low, high });
            }
            limits.v = limits.v.min(v);
        }
        let refusal = Refusal::OutOfRange { field: Field::Jerk, low: 0.0, high: 0.0 };
        Ok(Straight { path: Path::rest_to_rest(1.0, limits).ok_or(refusal)?, limits })
    }

    pub(super) fn scale(&self, axis: usize) -> StepsPerMicrometre {
        self.known(axis).settings.steps_per_um
    }

    /// Whether a move may end there.
    fn allowed(&self, index: usize, to: Nanometres) -> Result<(), Refusal> {
        let s = &self.known(index).settings;
        if to < s.low || to > s.high {
            return Err(Refusal::BeyondLimit { axis: Axis(index as u8), low: s.low, high: s.high });
        }
        Ok(())
    }

    /// Stage steps at which the axes will rest when the move that runs is over.
    fn targets(&self, board: &mut impl Board) -> [i32; AXES] {
        core::array::from_fn(|index| {
            let here = self.stage(index, board.pulses(|engine| engine.steps(index)));
            match &self.task {
                Task::Line { wish, .. } => wish.to[index].map_or(here, |to| self.scale(index).steps(to).0),
                _ => here,
            }
        })
    }

    /// Keeps an axis moving at a speed until told otherwise, or to its soft limit; 0 decelerates. Other axes that jog go on.
    ///
    /// # Errors
    /// [`Refusal::OutOfRange`], [`Refusal::BeyondLimit`] for a direction in which nothing is left, [`Refusal::AtHardLimit`],
    /// [`Refusal::Busy`] while something else goes on, [`Refusal::Emergency`], [`Refusal::NoSuchAxis`].
    pub fn jog(
        &mut self,
        now: BoardTime,
        board: &mut impl Board,
        axis: Axis,
        speed: MicrometresPerSecond,
    ) -> Result<MotionId, Refusal> {
        let index = axis.index().ok_or(Refusal::NoSuchAxis { axis })?;
        if !speed.0.is_finite() {
            return Err(Refusal::NotANumber);
        }
        if self.emergency {
            return Err(Refusal::Emergency);
        }
        let jogs = matches!(self.task, Task::Jog { .. }) && self.stopping.is_none();
        if !(jogs || self.resting() && self.queue.is_empty()) {
            return Err(Refusal::Busy);
        }
        let settings = self.known(index).settings;
        let scale = f64::from(settings.steps_per_um.0);
        let (low, high) = (limits::SLOWEST / scale, f64::from(settings.speed.0));
        let um_s = f64::from(speed.0.abs());
        if um_s != 0.0 && !(um_s >= low && um_s <= high) {
            return Err(Refusal::OutOfRange { field: Field::Speed, low: low as f32, high: high as f32 });
        }
        let side = if speed.0 > 0.0 { Side::High } else { Side::Low };
        if um_s != 0.0 {
            let stage = self.stage(index, board.pulses(|engine| engine.steps(index)));
            let here = settings.steps_per_um.nanometres(parfocal_protocol::units::Steps(stage));
            if (side == Side::High && here >= settings.high) || (side == Side::Low && here <= settings.low) {
                return Err(Refusal::BeyondLimit { axis, low: settings.low, high: settings.high });
            }
            if self.pressed(index, side) {
                return Err(Refusal::AtHardLimit { axis, side });
            }
        }
        if !matches!(self.task, Task::Jog { .. }) {
            self.running = self.next_id();
            self.stopped = None;
            self.track_play(board);
            self.task = Task::Jog { wanted: [0.0; AXES] };
        }
        if let Task::Jog { wanted } = &mut self.task
            && let Some(wanted) = wanted.get_mut(index)
        {
            *wanted = f64::from(speed.0) * scale / TICKS;
        }
        self.steer(now, board, index);
        Ok(self.running)
    }

    /// Swings an axis around where it rests: amplitude · cos(2π · frequency · t), `cycles` times, from a turning point that a
    /// move leads to and from.
    ///
    /// # Errors
    /// [`Refusal::OutOfRange`] naming the field, [`Refusal::BeyondLimit`], [`Refusal::Busy`], [`Refusal::Emergency`],
    /// [`Refusal::NoSuchAxis`].
    pub fn vibrate(
        &mut self,
        now: BoardTime,
        board: &mut impl Board,
        axis: Axis,
        amplitude: Nanometres,
        frequency: Hertz,
        cycles: u16,
    ) -> Result<MotionId, Refusal> {
        let index = axis.index().ok_or(Refusal::NoSuchAxis { axis })?;
        self.may_begin()?;
        self.track_play(board);
        let swinging = Swinging::new(self.known(index), index, amplitude, frequency, cycles)?;
        for end in swinging.turning_points() {
            self.allowed(index, end)?;
        }
        self.running = self.next_id();
        self.stopped = None;
        self.task = Task::Swing(swinging);
        self.swing_on(now, board);
        Ok(self.running)
    }

    /// Looks for an axis' home switch and takes its edge for the position set.
    ///
    /// # Errors
    /// [`Refusal::NoHomeSwitch`], [`Refusal::Busy`], [`Refusal::Emergency`], [`Refusal::NoSuchAxis`].
    pub fn home(&mut self, now: BoardTime, board: &mut impl Board, axis: Axis) -> Result<MotionId, Refusal> {
        let index = axis.index().ok_or(Refusal::NoSuchAxis { axis })?;
        self.may_begin()?;
        let settings = &self.known(index).settings;
        let Some(side) = settings.home.filter(|_| settings.has_switches) else {
            return Err(Refusal::NoHomeSwitch { axis });
        };
        self.running = self.next_id();
        self.stopped = None;
        self.task = Task::Home(Homing::new(index, side));
        self.home_on(now, board);
        Ok(self.running)
    }

    fn may_begin(&self) -> Result<(), Refusal> {
        if self.emergency {
            return Err(Refusal::Emergency);
        }
        if !self.resting() || !self.queue.is_empty() {
            return Err(Refusal::Busy);
        }
        Ok(())
    }

    /// Stops everything, decelerated, and forgets what waits. [`MotionEvent::Stopped`] follows when all is at rest.
    pub fn stop(&mut self, now: BoardTime, board: &mut impl Board, cause: StopCause) {
        let _ = now;
        self.queue.clear();
        self.held = false;
        if self.resting() || self.stopping.is_some() {
            return;
        }
        self.stopping = Some(cause);
        if let Task::Line { then, .. } = &mut self.task {
            then.clear();
        }
        self.slow_down(board, [true; AXES]);
    }

    /// Feed hold: decelerates along the path and keeps what is to come. Anything but moves and jogs is stopped.
    pub fn hold(&mut self, now: BoardTime, board: &mut impl Board) {
        match self.task {
            Task::Line { .. } | Task::Jog { .. } => {
                if !self.held && self.stopping.is_none() {
                    self.held = true;
                    self.slow_down(board, [true; AXES]);
                }
            }
            Task::Rest => self.held = true,
            Task::Swing(_) | Task::Home(_) => self.stop(now, board, StopCause::Asked),
        }
    }

    /// Goes on after a hold, as soon as everything rests.
    pub fn resume(&mut self) {
        self.held = false;
    }

    /// Lets axes slow down from as early a tick as can be.
    pub(super) fn slow_down(&mut self, board: &mut impl Board, axes: [bool; AXES]) {
        if let Task::Swing(swinging) = &mut self.task {
            swinging.stop();
        }
        let mut margin = PLANNING;
        for _ in 0..4 {
            let tick = board.pulses(|engine| engine.laid(axes)) + margin;
            let plans: [Option<Lane>; AXES] = core::array::from_fn(|i| {
                self.known(i).lane.as_ref().filter(|_| axes[i]).and_then(|lane| lane.stopping(tick))
            });
            if self.splice(board, tick, plans) {
                return;
            }
            margin *= 2;
        }
    }

    /// Replaces the paths of some axes from a tick on. False when it was too late for that.
    pub(super) fn splice(&mut self, board: &mut impl Board, tick: u64, plans: [Option<Lane>; AXES]) -> bool {
        let phases: [_; AXES] = core::array::from_fn(|i| plans[i].as_ref().map(Lane::phases));
        let before: [u32; AXES] =
            core::array::from_fn(|i| self.known(i).lane.as_ref().map_or(0, |lane| lane.steps_before(tick)));
        let done = board.pulses(|engine| {
            if engine.laid(core::array::from_fn(|i| phases[i].is_some())) > tick {
                return false;
            }
            let mut all = true;
            for (index, (phases, before)) in phases.iter().zip(before).enumerate() {
                if let Some(phases) = phases {
                    all &= engine.cut(index, tick, before) && engine.append(index, phases);
                }
            }
            all
        });
        if done {
            for (known, plan) in self.axes.iter_mut().zip(plans) {
                if let Some(plan) = plan {
                    known.past = known.lane.replace(plan);
                }
            }
        }
        done
    }

    /// Gives an axis that jogs the path to the speed wanted of it.
    pub(super) fn steer(&mut self, now: BoardTime, board: &mut impl Board, index: usize) {
        let Task::Jog { wanted } = &self.task else { return };
        let wanted = wanted.get(index).copied().unwrap_or(0.0);
        let moving = board.pulses(|engine| engine.busy(index));
        if !moving {
            self.track_play(board);
            if wanted != 0.0 && !self.held && self.stopping.is_none() {
                let known = self.known(index);
                let distance = known.to_limit(wanted > 0.0);
                let limits = Limits { v: wanted.abs(), ..limits::in_ticks(&known.settings) };
                if distance > 0.0
                    && let Some(path) = Path::rest_to_rest(distance, limits)
                {
                    self.set_lane(index, path, if wanted > 0.0 { 1.0 } else { -1.0 }, limits);
                    self.launch(now, board);
                }
            }
            return;
        }
        let mut margin = PLANNING;
        for _ in 0..4 {
            let Some(lane) = &self.known(index).lane else { return };
            let mut axes = [false; AXES];
            axes[index] = true;
            let tick = board.pulses(|engine| engine.laid(axes)) + margin;
            let same_way = wanted != 0.0 && (wanted > 0.0) == lane.up;
            let next = if same_way { faster_or_slower(lane, tick, wanted.abs()) } else { lane.stopping(tick) };
            let Some(next) = next else { return };
            let mut plans = [const { None }; AXES];
            plans[index] = Some(next);
            if self.splice(board, tick, plans) {
                return;
            }
            margin *= 2;
        }
    }

    /// Outputs off at once. Positions stay counted; those of axes that moved are no longer trusted.
    pub fn emergency(&mut self, now: BoardTime, board: &mut impl Board) {
        let moved: [bool; AXES] = core::array::from_fn(|i| board.pulses(|engine| engine.busy(i)));
        board.outputs_off();
        let _ = now;
        self.emergency = true;
        self.queue.clear();
        self.held = false;
        self.abandon(board, moved, StopCause::Emergency);
    }

    /// The pulses have ended, as they are: takes note, and tells.
    pub(super) fn abandon(&mut self, board: &mut impl Board, moved: [bool; AXES], cause: StopCause) {
        self.track_play(board);
        for (known, moved) in self.axes.iter_mut().zip(moved) {
            if moved {
                known.trust = Trust::Lost;
            }
            (known.lane, known.past) = (None, None);
        }
        (self.quiet, self.stopping) = (None, None);
        self.queue.clear();
        if !matches!(core::mem::take(&mut self.task), Task::Rest) {
            self.stopped = Some(cause);
            self.tell(MotionEvent::Stopped { motion: self.running, cause });
        }
    }

    /// Ends the emergency: outputs on again, nothing moves.
    ///
    /// # Errors
    /// [`Refusal::Emergency`] while the input is pressed.
    pub fn clear_emergency(&mut self, now: BoardTime, board: &mut impl Board) -> Result<(), Refusal> {
        let pressed = self.emergency_wired && board.inputs().emergency;
        let _ = now;
        if pressed {
            return Err(Refusal::Emergency);
        }
        if core::mem::take(&mut self.emergency) {
            board.outputs_on();
        }
        Ok(())
    }
}

impl Known {
    /// Motor steps to the soft limit on a side, play included; not positive when there are none.
    fn to_limit(&self, up: bool) -> f64 {
        let s = &self.settings;
        let stage = f64::from(self.seen.wrapping_sub(self.play.slack));
        if up {
            f64::from(s.steps_per_um.steps(s.high).0) - stage + f64::from(self.play.width - self.play.slack)
        } else {
            stage - f64::from(s.steps_per_um.steps(s.low).0) + f64::from(self.play.slack)
        }
    }
}

/// The lane that goes on from `tick` at speed `v`, to where this one ends.
fn faster_or_slower(lane: &Lane, tick: u64, v: f64) -> Option<Lane> {
    if tick >= lane.end() {
        return None;
    }
    let from = State { p: 0.0, ..lane.path.state(tick - lane.begin) };
    let left = lane.path.length() - lane.path.state(tick - lane.begin).p;
    // Slower tries, should the end be too near for the speed.
    let mut v = v;
    for _ in 0..6 {
        let mut path = Path::default();
        path.ramp(from, v, lane.limits)?;
        let mut rest = Path::default();
        rest.ramp(State { p: 0.0, v, a: 0.0 }, 0.0, lane.limits)?;
        let cruise = left - path.length() - rest.length();
        if cruise >= 0.0 {
            let top = State { p: path.length(), v, a: 0.0 };
            let ticks = (cruise / v) as u64;
            path.cruise(top, ticks);
            path.ramp(State { p: path.length(), v, a: 0.0 }, 0.0, lane.limits)?;
            let mut next = lane.then(tick, path);
            next.limits.v = v;
            return Some(next);
        }
        v /= 2.0;
    }
    lane.stopping(tick)
}
