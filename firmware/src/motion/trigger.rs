//! Camera pulses at positions: which steps give them, and what is told of those given.

use super::camera::{Taken, Wanted};
use super::facade::{Motion, MotionEvent};
use crate::ports::Board;
use parfocal_protocol::message::{Field, Refusal, TriggerPlan};
use parfocal_protocol::units::Nanometres;

/// Most pulses of a plan.
const MOST: u16 = 60_000;

/// A plan under way.
#[derive(Clone, Debug)]
pub(super) struct Triggers {
    plan: TriggerPlan,
    /// The next pulse to hand over.
    next: u16,
    /// Which way the axis went when the last one was handed over.
    up: bool,
}

impl Triggers {
    pub const fn new() -> Self {
        Self { plan: TriggerPlan::Off, next: 0, up: true }
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
}

impl Motion {
    /// Sets the positions at which camera pulses are given while an axis passes them, in their order; replaces the plan before.
    ///
    /// # Errors
    /// [`Refusal::NoSuchAxis`], [`Refusal::NoTrigger`], [`Refusal::OutOfRange`] for a distance of 0, no pulse at all or too many;
    /// [`Refusal::Busy`] when another axis gave pulses before and anything moves.
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
        let axis = Triggers { plan: *plan, ..Triggers::new() }.axis();
        if let Some(index) = axis
            && !board.has_trigger(index)
        {
            return Err(Refusal::NoTrigger { axis: parfocal_protocol::units::Axis(index as u8) });
        }
        // The hardware begins to count an axis' records while it rests.
        if axis.is_some() && axis != self.counted && !self.resting() {
            return Err(Refusal::Busy);
        }
        self.tell_pulses(board);
        self.triggers = Triggers { plan: *plan, ..Triggers::new() };
        self.counted = axis;
        board.pulses(|engine| engine.watch_for_camera(axis));
        Ok(())
    }

    /// No pulses any more.
    pub(super) fn end_triggers(&mut self, board: &mut impl Board) {
        self.triggers = Triggers::new();
        self.counted = None;
        board.pulses(|engine| engine.watch_for_camera(None));
    }

    /// Tells of the pulses given.
    pub(super) fn tell_pulses(&mut self, board: &mut impl Board) {
        while let Some((index, at)) = board.pulses(|engine| engine.pulse_given()) {
            let time = board.pulses(|engine| engine.time(at));
            if let Some(position) = self.triggers.position(index) {
                self.tell(MotionEvent::Triggered { index, time, position });
            }
        }
    }

    /// Hands the next pulses to the engine, and tells of those given.
    pub(super) fn watch_triggers(&mut self, board: &mut impl Board) {
        let Some(axis) = self.triggers.axis() else { return };
        self.tell_pulses(board);
        while let Some(position) = self.triggers.position(self.triggers.next) {
            let known = self.known(axis);
            let Some(lane) = &known.lane else { return };
            let up = lane.up;
            let stage = known.settings.steps_per_um.steps(position).0;
            // The stage is there when the motor is, with the play on the side it pushes from.
            let count = stage.saturating_add(if up { known.play.width } else { 0 });
            if lane.tick_of(count).is_none() {
                return;
            }
            if up != self.triggers.up {
                // Those handed over for the other way are not passed now.
                self.triggers.up = up;
                if let Some(first) = board.pulses(|engine| engine.unwant_pulses()) {
                    self.triggers.next = first;
                    continue;
                }
            }
            let index = self.triggers.next;
            match board.pulses(|engine| engine.want_pulse(Wanted { index, count, up })) {
                Taken::Full => return,
                // A step passed too soon to be prepared has no pulse, and no event tells of one.
                Taken::Yes | Taken::Late => self.triggers.next += 1,
            }
        }
    }
}
