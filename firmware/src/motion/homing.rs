//! Homing on a limit switch: fast towards it, off it, slowly towards it again; its edge is the position set.

use super::facade::{Motion, Task};
use super::limits::{self, TICKS};
use super::path::{Limits, Path};
use crate::ports::Board;
use parfocal_protocol::message::{HomingFault, StopCause, Trust};
use parfocal_protocol::settings::Side;
use parfocal_protocol::units::Axis;

/// How much slower the second approach is.
const SLOWER: f64 = 10.0;

/// A homing under way.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Homing {
    pub axis: usize,
    pub side: Side,
    pub stage: Stage,
}

/// Where it stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Stage {
    /// To be begun.
    Begin,
    /// Fast towards the switch.
    Approach,
    /// Stopping on the switch, or beyond where it opened.
    Stopping { then: Next },
    /// Away from the switch until it opens.
    BackOff,
    /// Slowly towards the switch.
    Touch,
    /// Done; the motor count at which the switch closed.
    Done { edge: i32 },
}

/// What comes after a stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Next {
    BackOff,
    Touch,
    Set { edge: i32 },
}

impl Homing {
    pub fn new(axis: usize, side: Side) -> Self {
        Self { axis, side, stage: Stage::Begin }
    }
}

impl Motion {
    /// Takes homing one step on: called at every poll while it goes on.
    pub(super) fn home_on(&mut self, board: &mut impl Board) {
        let Task::Home(homing) = &self.task else { return };
        let homing = homing.clone();
        let (axis, side) = (homing.axis, homing.side);
        let (pressed, other) = (self.pressed(axis, side), self.pressed(axis, opposite(side)));
        let busy = board.pulses(|engine| engine.busy(axis));
        let speed = f64::from(self.known(axis).settings.home_speed.0);
        let next = match homing.stage {
            // At both ends at once: no way leads off them.
            Stage::Begin | Stage::BackOff if pressed && other => {
                return self.fail_home(board, axis, HomingFault::Stuck);
            }
            Stage::Begin if pressed => self.run_home(board, axis, opposite(side), speed, Stage::BackOff),
            Stage::Begin => self.run_home(board, axis, side, speed, Stage::Approach),
            Stage::Approach if pressed => self.halt_home(board, axis, Next::BackOff),
            Stage::Approach if other => return self.fail_home(board, axis, HomingFault::WrongSide),
            Stage::Approach if !busy => return self.fail_home(board, axis, HomingFault::Missing),
            Stage::BackOff if !pressed => self.halt_home(board, axis, Next::Touch),
            Stage::BackOff if !busy => return self.fail_home(board, axis, HomingFault::Stuck),
            Stage::Touch if pressed => {
                // The debounced level comes late: the edge is where the axis was when the level began.
                let known = self.known(axis);
                let since = if side == Side::Low { known.low.since() } else { known.high.since() };
                let tick = board.pulses(|engine| engine.tick(since));
                let edge = known.lane.as_ref().map_or(known.seen, |lane| lane.count_at(tick));
                self.halt_home(board, axis, Next::Set { edge })
            }
            Stage::Touch if !busy => return self.fail_home(board, axis, HomingFault::Missing),
            Stage::Stopping { then } if !busy => match then {
                Next::BackOff => self.run_home(board, axis, opposite(side), speed, Stage::BackOff),
                Next::Touch => self.run_home(board, axis, side, speed / SLOWER, Stage::Touch),
                Next::Set { edge } => {
                    self.set_home(board, axis, edge);
                    Stage::Done { edge }
                }
            },
            same => same,
        };
        if let Task::Home(homing) = &mut self.task {
            homing.stage = next;
        }
    }

    /// Runs towards a side for as far as the axis reaches.
    fn run_home(&mut self, board: &mut impl Board, axis: usize, side: Side, um_s: f64, stage: Stage) -> Stage {
        self.track_play(board);
        let known = self.known(axis);
        let s = &known.settings;
        let scale = f64::from(s.steps_per_um.0);
        // The whole range and a tenth: the switch lies within, wherever the axis started.
        let range = (f64::from(s.high.0) - f64::from(s.low.0)) / 1000.0 * scale * 1.1 + f64::from(known.play.width);
        let limits = Limits { v: um_s * scale / TICKS, ..limits::in_ticks(s) };
        if let Some(path) = Path::rest_to_rest(super::math::floor(range).max(1.0), limits) {
            self.set_lane(axis, path, if side == Side::High { 1.0 } else { -1.0 }, limits);
            self.launch(board);
        }
        stage
    }

    fn halt_home(&mut self, board: &mut impl Board, axis: usize, then: Next) -> Stage {
        let mut axes = [false; parfocal_protocol::units::AXES];
        if let Some(axis) = axes.get_mut(axis) {
            *axis = true;
        }
        self.slow_down(board, axes);
        Stage::Stopping { then }
    }

    fn fail_home(&mut self, board: &mut impl Board, axis: usize, fault: HomingFault) {
        if self.stopping.is_none() {
            self.stopping = Some(StopCause::Homing { axis: Axis(axis as u8), fault });
            self.slow_down(board, [true; parfocal_protocol::units::AXES]);
        }
    }

    /// The switch closed at motor count `edge`: that is the home position.
    fn set_home(&mut self, board: &mut impl Board, axis: usize, edge: i32) {
        self.track_play(board);
        let known = self.known_mut(axis);
        // Approaching took up the play on this side, at the edge as here.
        let home = known.settings.steps_per_um.steps(known.settings.home_at).0.saturating_add(known.play.slack);
        let motor = home.saturating_add(known.seen.wrapping_sub(edge));
        known.seen = motor;
        known.trust = Trust::Known;
        (known.lane, known.past) = (None, None);
        board.pulses(|engine| engine.set_steps(axis, motor));
    }
}

fn opposite(side: Side) -> Side {
    match side {
        Side::Low => Side::High,
        Side::High => Side::Low,
    }
}
