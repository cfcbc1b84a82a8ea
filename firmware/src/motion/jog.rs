//! Jog: a speed until told otherwise, changed on the fly.

use super::facade::{Known, Motion, Task};
use super::lane::Lane;
use super::limits::{self, TICKS};
use super::path::{Limits, Path};
use super::stops::PLANNING;
use super::stretch::State;
use crate::ports::Board;
use parfocal_protocol::message::{Field, MotionId, Refusal};
use parfocal_protocol::settings::Side;
use parfocal_protocol::units::{AXES, Axis, BoardTime, MicrometresPerSecond, Steps};

impl Motion {
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
        self.watch_pulses(now, board);
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
        if let Task::Jog { wanted } = &self.task {
            // What the other axes' pulses leave of what DMA can carry.
            let others: f64 = (0..AXES)
                .filter(|i| *i != index)
                .map(|i| limits::records(&self.known(i).settings, wanted[i].abs() * TICKS))
                .sum();
            let left = limits::RECORDS_PER_SECOND - others;
            if limits::records(&settings, um_s * scale) > left {
                let high = left / limits::records(&settings, scale);
                return Err(Refusal::OutOfRange { field: Field::Speed, low: low as f32, high: high as f32 });
            }
        }
        let side = if speed.0 > 0.0 { Side::High } else { Side::Low };
        if um_s != 0.0 {
            let stage = self.stage(index, board.pulses(|engine| engine.steps(index)));
            let here = settings.steps_per_um.nanometres(Steps(stage));
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
        self.steer(board, index);
        Ok(self.running)
    }

    /// Gives an axis that jogs the path to the speed wanted of it.
    pub(super) fn steer(&mut self, board: &mut impl Board, index: usize) {
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
                    self.launch(board);
                }
            }
            return;
        }
        let mut margin = PLANNING;
        for _ in 0..4 {
            let Some(lane) = &self.known(index).lane else { return };
            let mut axes = [false; AXES];
            axes[index] = true;
            let tick = (board.pulses(|engine| engine.laid(axes)) + margin).max(lane.begin);
            let same_way = wanted != 0.0 && !self.held && (wanted > 0.0) == lane.up;
            let next = if same_way { faster_or_slower(lane, tick, wanted.abs()) } else { lane.stopping(tick) };
            let Some(next) = next else { return };
            let mut plans = [const { None }; AXES];
            plans[index] = Some((next, lane.steps_before(tick)));
            if self.splice(board, tick, plans) {
                return;
            }
            margin *= 2;
        }
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
