//! Moves: planned here, handed to the engine, stopped and held.

use super::facade::{Ending, Leg, Motion, Task, Wish};
use super::homing::Homing;
use super::lane::Lane;
use super::limits::{self, RECORDS_PER_SECOND, TICKS};
use super::math::sqrt;
use super::path::{Limits, Path};
use super::swing::Swinging;
use crate::ports::Board;
use heapless::Vec;
use parfocal_protocol::message::{Field, MotionId, Refusal};
use parfocal_protocol::settings::Side;
use parfocal_protocol::units::{
    AXES, Axis, BoardTime, Hertz, MicrometresPerSecond, Nanometres, PerAxis, StepsPerMicrometre,
};

/// Between the records laid and the first path from rest, ticks: DIR's setup fits in.
const BEGINNING: u64 = 2_000;

/// Longest time on a line, ticks: four months, well within what a path's arithmetic spans.
const LONGEST_LINE: f64 = 9e14;

/// A straight line for several axes at once.
struct Straight {
    path: Path,
    limits: Limits,
}

impl Straight {
    /// From rest to rest over all of it.
    fn within(limits: Limits) -> Option<Self> {
        Some(Self { path: Path::rest_to_rest(1.0, limits)?, limits })
    }
}

impl Motion {
    /// Moves in a straight line to absolute positions, behind the moves that wait already.
    ///
    /// # Errors
    /// [`Refusal::BeyondLimit`], [`Refusal::OutOfRange`] for a speed that is too slow or more than the axes allow along this
    /// line, [`Refusal::AtHardLimit`], [`Refusal::QueueFull`], [`Refusal::Emergency`], [`Refusal::Busy`] while something
    /// other than moves goes on.
    // A function of its own in the program, too: the emulator counts what leads to it.
    #[inline(never)]
    pub fn move_to(
        &mut self,
        now: BoardTime,
        board: &mut impl Board,
        to: &PerAxis<Option<Nanometres>>,
        speed: Option<MicrometresPerSecond>,
        ending: Ending,
    ) -> Result<MotionId, Refusal> {
        self.watch_pulses(now, board);
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
        let limits = self.line_limits(&from, &goal, speed)?;
        let id = self.next_id();
        let wish = Wish { id, to: *to, speed, ending };
        let _ = self.queue.push_back(wish);
        if !waits {
            self.begin_next(board, limits.map(|limits| (from, goal, limits)));
        }
        Ok(id)
    }

    /// Begins the first move that waits.
    pub(super) fn next_move(&mut self, board: &mut impl Board) {
        self.begin_next(board, None);
    }

    /// The same, with the limits of a leg that are known already.
    fn begin_next(&mut self, board: &mut impl Board, known: Option<([i32; AXES], Leg, Limits)>) {
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
            let side = known.settings.approach.filter(|_| wish.ending == Ending::Approach);
            let legs = known.play.legs(from, to, side, overshoot);
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
        self.start_leg(board, known);
    }

    /// Starts the axes of the leg that is due.
    pub(super) fn begin_leg(&mut self, board: &mut impl Board) {
        self.start_leg(board, None);
    }

    fn start_leg(&mut self, board: &mut impl Board, known: Option<([i32; AXES], Leg, Limits)>) {
        self.quiet = None;
        let Task::Line { wish, now: leg, .. } = &self.task else { return };
        let (leg, speed) = (*leg, wish.speed);
        self.track_play(board);
        let from: [i32; AXES] = core::array::from_fn(|i| self.known(i).seen);
        // Refused when asked for; a plan that fails here begins nothing and so ends at once.
        let known = known.filter(|k| k.0 == from && k.1 == leg).and_then(|k| Straight::within(k.2));
        let straight = known.map_or_else(|| self.straight(&from, &leg, speed), Ok);
        let straight = straight.or_else(|_| self.straight(&from, &leg, None));
        let Ok(straight) = straight else { return };
        for (index, from) in from.into_iter().enumerate() {
            let Some(to) = leg[index].filter(|to| *to != from) else { continue };
            let distance = f64::from(to.wrapping_sub(from));
            self.set_lane(index, straight.path.clone(), distance, straight.limits);
        }
        self.launch(board);
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
    pub(super) fn launch(&mut self, board: &mut impl Board) {
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
        let Some(limits) = self.line_limits(from, to, speed)? else {
            return Ok(Straight { path: Path::default(), limits: Limits { v: 1.0, a: 1.0, j: 1.0 } });
        };
        Straight::within(limits).ok_or(Refusal::OutOfRange { field: Field::Jerk, low: 0.0, high: 0.0 })
    }

    /// The limits of a line between motor counts, in units of all of it; `None` when nothing is to be done. A line that these
    /// limits allow has a path: ramps are as short as [`limits::check`] wants them, and the cruise is bounded here.
    fn line_limits(
        &self,
        from: &[i32; AXES],
        to: &Leg,
        speed: Option<MicrometresPerSecond>,
    ) -> Result<Option<Limits>, Refusal> {
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
                _ => Ok(None),
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
        if limits.v * LONGEST_LINE < 1.0 {
            let (low, high) = ((length * TICKS / LONGEST_LINE) as f32, (limits.v * length * TICKS) as f32);
            return Err(Refusal::OutOfRange { field: Field::Speed, low, high: high.max(low) });
        }
        Ok(Some(limits))
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
        self.watch_pulses(now, board);
        self.may_begin()?;
        self.track_play(board);
        let swinging = Swinging::new(self.known(index), index, amplitude, frequency, cycles)?;
        for end in swinging.turning_points() {
            self.allowed(index, end)?;
        }
        self.running = self.next_id();
        self.stopped = None;
        self.task = Task::Swing(swinging);
        self.swing_on(board);
        Ok(self.running)
    }

    /// Looks for an axis' home switch and takes its edge for the position set.
    ///
    /// # Errors
    /// [`Refusal::NoHomeSwitch`], [`Refusal::Busy`], [`Refusal::Emergency`], [`Refusal::NoSuchAxis`].
    pub fn home(&mut self, now: BoardTime, board: &mut impl Board, axis: Axis) -> Result<MotionId, Refusal> {
        let index = axis.index().ok_or(Refusal::NoSuchAxis { axis })?;
        self.watch_pulses(now, board);
        self.may_begin()?;
        let settings = &self.known(index).settings;
        let Some(side) = settings.home.filter(|_| settings.has_switches) else {
            return Err(Refusal::NoHomeSwitch { axis });
        };
        self.running = self.next_id();
        self.stopped = None;
        self.task = Task::Home(Homing::new(index, side));
        self.home_on(board);
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
}
