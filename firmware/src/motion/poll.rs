//! What happens while nobody asks for anything: switches are watched, legs follow legs, ends are told.

use super::engine::GAP;
use super::facade::{Motion, MotionEvent, Task};
use super::homing::Stage;
use crate::ports::Board;
use parfocal_protocol::message::{StopCause, Trust};
use parfocal_protocol::settings::Side;
use parfocal_protocol::units::{AXES, Axis, BoardTime};

impl Motion {
    /// Goes on with what is being done; to be called every millisecond or so, until it returns nothing more to tell.
    pub fn poll(&mut self, now: BoardTime, board: &mut impl Board) -> Option<MotionEvent> {
        self.watch_inputs(now, board);
        self.watch_pulses(now, board);
        self.watch_triggers(board);
        self.go_on(now, board);
        self.events.pop_front()
    }

    fn watch_inputs(&mut self, now: BoardTime, board: &mut impl Board) {
        let inputs = board.inputs();
        for (index, known) in self.axes.iter_mut().enumerate() {
            let s = &known.settings;
            let low = Self::means_pressed(s, inputs.low_switch[index]);
            let high = Self::means_pressed(s, inputs.high_switch[index]);
            known.low.read(now, low);
            known.high.read(now, high);
        }
        let was = self.emergency_input.level();
        // Opening counts at once, for safety; only closing is debounced.
        let raw = self.emergency_wired && inputs.emergency;
        let pressed = self.emergency_input.read(now, raw) || raw;
        if pressed && !was {
            self.emergency_input.force(now, true);
            if !self.emergency {
                self.emergency(now, board);
            }
            self.tell(MotionEvent::EmergencyInput { pressed: true });
        } else if was && !self.emergency_input.level() {
            self.tell(MotionEvent::EmergencyInput { pressed: false });
        }
        if self.stopping.is_some() || matches!(self.task, Task::Rest | Task::Home(_)) {
            return;
        }
        for index in 0..AXES {
            let Some(lane) = &self.known(index).lane else { continue };
            let side = if lane.up { Side::High } else { Side::Low };
            let swings = matches!(&self.task, Task::Swing(s) if s.axis == index);
            let both = swings && (self.pressed(index, Side::Low) || self.pressed(index, Side::High));
            if (both || self.pressed(index, side)) && board.pulses(|engine| engine.busy(index)) {
                let cause = StopCause::HardLimit { axis: Axis(index as u8), side };
                return self.stop(now, board, cause);
            }
        }
    }

    /// Takes note of pulses that failed to come.
    pub(super) fn watch_pulses(&mut self, now: BoardTime, board: &mut impl Board) {
        let (gap, late) = board.pulses(|engine| (engine.take_gap(), engine.take_late()));
        if let Some(gap) = gap.filter(|g| g.ticks > GAP) {
            // The engine has let go of all paths: the axes stand where they are counted, if their motors followed.
            let moved = core::array::from_fn(|i| self.known(i).lane.is_some());
            self.abandon(board, moved, StopCause::Underrun { axis: Axis(gap.axis as u8) });
        }
        if let Some(axis) = late {
            self.known_mut(axis).trust = Trust::Lost;
            self.stop(now, board, StopCause::Underrun { axis: Axis(axis as u8) });
        }
    }

    fn go_on(&mut self, now: BoardTime, board: &mut impl Board) {
        if matches!(self.task, Task::Home(_)) && self.stopping.is_none() {
            self.home_on(board);
        }
        if let Task::Jog { wanted } = &self.task {
            let wanted = *wanted;
            for (index, wanted) in wanted.into_iter().enumerate() {
                let waits = wanted != 0.0 && !self.held && self.stopping.is_none();
                if waits && self.arrived(now, board, index) && self.turned_round(index, wanted) {
                    self.steer(board, index);
                }
            }
        }
        if self.resting() {
            if !self.queue.is_empty() && !self.held && !self.emergency {
                self.next_move(board);
            }
            return;
        }
        if !(0..AXES).all(|index| self.arrived(now, board, index)) {
            self.quiet = None;
            return;
        }
        if self.held || !self.next_stretch(board) {
            self.settle(now, board);
        }
    }

    /// Whether an axis' last edge is out and its path over.
    fn arrived(&self, now: BoardTime, board: &mut impl Board, index: usize) -> bool {
        let over = self.known(index).lane.as_ref().map_or(0, |lane| lane.end());
        board.pulses(|engine| !engine.busy(index) && engine.tick(now) >= over)
    }

    /// Whether an axis that jogs stands because it was to turn round, not because it came to its limit.
    fn turned_round(&self, index: usize, wanted: f64) -> bool {
        self.known(index).lane.as_ref().is_none_or(|lane| lane.up != (wanted > 0.0) || lane.limits.v == 0.0)
    }

    /// Begins what comes next in the present task. False when it is over.
    fn next_stretch(&mut self, board: &mut impl Board) -> bool {
        if self.stopping.is_some() {
            return false;
        }
        match &mut self.task {
            Task::Line { now: leg, then, .. } => {
                // After a hold, the leg that was cut short goes on.
                let leg = *leg;
                let short = (0..AXES).any(|i| leg[i].is_some_and(|to| board.pulses(|engine| engine.steps(i)) != to));
                if !short {
                    let Some(next) = then.pop() else { return false };
                    if let Task::Line { now: leg, .. } = &mut self.task {
                        *leg = next;
                    }
                }
                self.begin_leg(board);
                true
            }
            Task::Swing(_) => self.swing_on(board),
            Task::Home(homing) => !matches!(homing.stage, Stage::Done { .. }),
            Task::Jog { .. } | Task::Rest => false,
        }
    }

    /// All edges are out: waits for the settling time, then tells.
    fn settle(&mut self, now: BoardTime, board: &mut impl Board) {
        let since = *self.quiet.get_or_insert(now);
        if self.held && self.stopping.is_none() {
            return;
        }
        let settling = self.axes.iter().filter(|k| k.lane.is_some()).map(|k| k.settings.settling.0).max();
        if now.since(since) < u64::from(settling.unwrap_or(0)) * 1000 {
            return;
        }
        self.track_play(board);
        self.task = Task::Rest;
        self.quiet = None;
        for known in &mut self.axes {
            // Kept for looking back at where the axis was.
            if known.lane.is_some() {
                known.past = known.lane.take();
            }
        }
        for index in 0..AXES {
            if self.known(index).settings.idle_off && self.known(index).enabled {
                self.known_mut(index).enabled = false;
                board.enable(index, false);
            }
        }
        match self.stopping.take() {
            Some(cause) => {
                self.stopped = Some(cause);
                self.tell(MotionEvent::Stopped { motion: self.running, cause });
            }
            None => self.tell(MotionEvent::InPosition(self.running)),
        }
    }
}
