//! Stopping: decelerated, held, or at once.

use super::engine::TICKS_PER_US;
use super::facade::{Motion, MotionEvent, Task};
use super::lane::Lane;
use crate::ports::Board;
use parfocal_protocol::message::{Refusal, StopCause, Trust};
use parfocal_protocol::units::{AXES, BoardTime};

/// Between the records laid and the tick at which a changed path may begin, ticks: time to plan it, 0.5 ms.
pub(super) const PLANNING: u64 = 500 * TICKS_PER_US;

impl Motion {
    /// Stops everything, decelerated, and forgets what waits. [`MotionEvent::Stopped`] follows when all is at rest.
    pub fn stop(&mut self, now: BoardTime, board: &mut impl Board, cause: StopCause) {
        self.watch_pulses(now, board);
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
        self.watch_pulses(now, board);
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
            // A path that was changed a moment ago begins first.
            let begin = self.axes.iter().zip(axes).filter(|(_, take)| *take).filter_map(|(k, _)| k.lane.as_ref());
            let begin = begin.map(|lane| lane.begin).max().unwrap_or(0);
            let tick = (board.pulses(|engine| engine.laid(axes)) + margin).max(begin);
            let plans = core::array::from_fn(|i| match &self.task {
                _ if !axes[i] => None,
                Task::Swing(swinging) if swinging.axis == i && swinging.swings() => {
                    swinging.stopping(tick, self.known(i))
                }
                _ => self.known(i).lane.as_ref().and_then(|lane| Some((lane.stopping(tick)?, lane.steps_before(tick)))),
            });
            if self.splice(board, tick, plans) {
                return;
            }
            margin *= 2;
        }
    }

    /// Replaces the paths of some axes from a tick on; each comes with the edges that remain of the phase there. False when
    /// it was too late for that.
    pub(super) fn splice(&mut self, board: &mut impl Board, tick: u64, plans: [Option<(Lane, u32)>; AXES]) -> bool {
        let phases = core::array::from_fn(|i| plans[i].as_ref().map(|(lane, before)| (*before, lane.phases())));
        let done = board.pulses(|engine| engine.splice(tick, &phases));
        if done {
            for (known, plan) in self.axes.iter_mut().zip(plans) {
                if let Some((lane, _)) = plan {
                    if known.lane.is_none() {
                        // Out of a vibration: its turns are not followed one by one.
                        (known.seen, known.play) = (lane.base, lane.play);
                    }
                    known.past = known.lane.replace(lane);
                }
            }
        }
        done
    }

    /// Outputs off at once. Positions stay counted; those of axes that moved are no longer trusted.
    pub fn emergency(&mut self, _now: BoardTime, board: &mut impl Board) {
        let moved: [bool; AXES] = core::array::from_fn(|i| board.pulses(|engine| engine.busy(i)));
        board.outputs_off();
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
        // A plan of camera pulses ends with what it belonged to.
        self.tell_pulses(board);
        self.end_triggers(board);
        if !matches!(core::mem::take(&mut self.task), Task::Rest) {
            self.stopped = Some(cause);
            self.tell(MotionEvent::Stopped { motion: self.running, cause });
        }
    }

    /// Ends the emergency: outputs on again, nothing moves.
    ///
    /// # Errors
    /// [`Refusal::Emergency`] while the input is pressed.
    pub fn clear_emergency(&mut self, _now: BoardTime, board: &mut impl Board) -> Result<(), Refusal> {
        let pressed = self.emergency_wired && board.inputs().emergency;
        if pressed {
            return Err(Refusal::Emergency);
        }
        if core::mem::take(&mut self.emergency) {
            board.outputs_on();
        }
        Ok(())
    }
}
