//! Camera pulses at positions: the planned path tells their ticks ahead, hardware gives them.

use super::facade::{Motion, MotionEvent};
use crate::ports::Board;
use heapless::Deque;
use parfocal_protocol::message::{Field, Refusal, TriggerPlan};
use parfocal_protocol::units::{BoardTime, Nanometres};

/// Pulses handed to the engine ahead of time.
pub const AHEAD: usize = 8;

/// Nearest tick for which a pulse can still be prepared: it must not lie behind the engine's next look. 0.3 ms.
const SOONEST: u64 = 25_200;

/// Most pulses of a plan.
const MOST: u16 = 60_000;

/// A plan under way.
#[derive(Clone, Debug)]
pub(super) struct Triggers {
    plan: TriggerPlan,
    /// The next pulse to hand over.
    next: u16,
    /// Pulses handed over and not told yet: index and tick.
    due: Deque<(u16, u64), AHEAD>,
}

impl Triggers {
    pub const fn new() -> Self {
        Self { plan: TriggerPlan::Off, next: 0, due: Deque::new() }
    }

    fn axis(&self) -> Option<usize> {
        match self.plan {
            TriggerPlan::Off => None,
            TriggerPlan::Every { axis, .. } | TriggerPlan::At { axis, .. } => axis.index(),
        }
    }

    fn position(&self, index: u16) -> Option<Nanometres> {
        match self.plan {
            TriggerPlan::Off => None,
            TriggerPlan::Every { first, every, count, .. } => {
                let at = i64::from(first.0) + i64::from(every.0) * i64::from(index);
                (index < count).then_some(Nanometres(i32::try_from(at).ok()?))
            }
            TriggerPlan::At { positions, len, .. } => {
                (index < u16::from(len)).then(|| positions.get(usize::from(index)).copied())?
            }
        }
    }

    /// Paths changed from `tick` on: pulses behind it are planned anew.
    pub fn cut(&mut self, tick: u64) {
        while let Some((index, _)) = self.due.back().filter(|(_, at)| *at >= tick) {
            self.next = *index;
            self.due.pop_back();
        }
    }
}

impl Motion {
    /// Sets the positions at which camera pulses are given while an axis passes them, in their order; replaces the plan before.
    ///
    /// # Errors
    /// [`Refusal::NoSuchAxis`], [`Refusal::OutOfRange`] for a distance of 0, no pulse at all or too many.
    pub fn trigger(&mut self, board: &mut impl Board, plan: &TriggerPlan) -> Result<(), Refusal> {
        let refuse = |low: f32, high: f32| Err(Refusal::OutOfRange { field: Field::Trigger, low, high });
        match *plan {
            TriggerPlan::Off => {}
            TriggerPlan::Every { axis, every, count, .. } => {
                axis.index().ok_or(Refusal::NoSuchAxis { axis })?;
                if every.0 == 0 {
                    return refuse(0.001, 1e6);
                }
                if count == 0 || count > MOST {
                    return refuse(1.0, f32::from(MOST));
                }
            }
            TriggerPlan::At { axis, positions, len } => {
                axis.index().ok_or(Refusal::NoSuchAxis { axis })?;
                if len == 0 || usize::from(len) > positions.len() {
                    return refuse(1.0, positions.len() as f32);
                }
            }
        }
        self.triggers = Triggers { plan: *plan, ..Triggers::new() };
        board.pulses(|engine| engine.drop_triggers(0));
        Ok(())
    }

    /// Hands the next pulses to the engine, and tells of those given.
    pub(super) fn watch_triggers(&mut self, now: BoardTime, board: &mut impl Board) {
        let Some(axis) = self.triggers.axis() else { return };
        let tick = board.pulses(|engine| engine.tick(now));
        while let Some((index, at)) = self.triggers.due.front().copied().filter(|(_, at)| *at <= tick) {
            self.triggers.due.pop_front();
            let time = board.pulses(|engine| engine.time(at));
            if let Some(position) = self.triggers.position(index) {
                self.tell(MotionEvent::Triggered { index, time, position });
            }
        }
        while !self.triggers.due.is_full() {
            let Some(position) = self.triggers.position(self.triggers.next) else { return };
            let known = self.known(axis);
            let Some(lane) = &known.lane else { return };
            let stage = known.settings.steps_per_um.steps(position).0;
            // The stage is there when the motor is, with the play on the side it pushes from.
            let motor = stage.saturating_add(if lane.up { known.play.width } else { 0 });
            let Some(at) = lane.tick_of(motor) else { return };
            let after = self.triggers.due.back().map_or(0, |(_, at)| *at);
            if at >= (tick + SOONEST).max(after) {
                if !board.pulses(|engine| engine.add_trigger(axis, at)) {
                    return;
                }
                let _ = self.triggers.due.push_back((self.triggers.next, at));
            }
            // A position passed too soon to be prepared has no pulse, and no event tells of one.
            self.triggers.next += 1;
        }
    }
}
