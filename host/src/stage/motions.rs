//! What an axis can do besides moving to a place: home, jog, vibrate; and what is declared or switched while it rests.

use super::{Stage, StageError};
use crate::link::LinkError;
use crate::link::transport::later;
use crate::rig::AxisName;
use parfocal_protocol::message::{MotionId, Request, Response, TriggerPlan};
use parfocal_protocol::units::{Axis, Hertz, Micrometres, MicrometresPerSecond};

/// A motion that was begun: which board, and its number there.
pub type Begun = (usize, MotionId);

impl Stage {
    /// Begins to look for an axis' home switch.
    ///
    /// # Errors
    /// [`StageError`]; the board says when the axis has no home switch.
    pub fn home(&mut self, name: AxisName) -> Result<Begun, StageError> {
        self.begin_on(name, |axis| Request::Home { axis })
    }

    /// Keeps an axis moving until told otherwise or to its soft limit; asked again, changes the speed on the fly; 0 decelerates.
    ///
    /// # Errors
    /// [`StageError`]; the board names the range of speeds.
    pub fn jog(&mut self, name: AxisName, speed: MicrometresPerSecond) -> Result<Begun, StageError> {
        self.begin_on(name, |axis| Request::Jog { axis, speed })
    }

    /// Swings an axis around where it rests; `amplitude` is half the way between the turning points.
    ///
    /// # Errors
    /// [`StageError`]; the board names what is out of range.
    pub fn vibrate(
        &mut self,
        name: AxisName,
        amplitude: Micrometres,
        frequency: Hertz,
        cycles: u16,
    ) -> Result<Begun, StageError> {
        let amplitude = amplitude.nanometres().ok_or(StageError::NoPosition { name, at: amplitude.0 })?;
        self.begin_on(name, |axis| Request::Vibrate { axis, amplitude, frequency, cycles })
    }

    /// Declares where a resting axis is, without moving it.
    ///
    /// # Errors
    /// [`StageError`]; the board refuses while anything moves.
    pub fn declare(&mut self, name: AxisName, at: Micrometres) -> Result<(), StageError> {
        let at = at.nanometres().ok_or(StageError::NoPosition { name, at: at.0 })?;
        let (link, axis) = self.find(name)?;
        link.request(Request::SetPosition { axis, at })?;
        Ok(())
    }

    /// Switches the current of an axis' driver.
    ///
    /// # Errors
    /// [`StageError`]; the board refuses to switch it off while anything moves.
    pub fn enable(&mut self, name: AxisName, on: bool) -> Result<(), StageError> {
        let (link, axis) = self.find(name)?;
        link.request(Request::Enable { axis, on })?;
        Ok(())
    }

    /// Sets when an axis' board gives camera pulses; `plan` gets the axis' number there.
    ///
    /// # Errors
    /// [`StageError`]; the board names the allowed range, or says that the axis has no trigger.
    pub fn trigger(&mut self, name: AxisName, plan: impl FnOnce(Axis) -> TriggerPlan) -> Result<(), StageError> {
        let (link, axis) = self.find(name)?;
        link.request(Request::Trigger { plan: plan(axis) })?;
        Ok(())
    }

    /// Feed hold of every board: decelerate, keep what is to come. `on` false goes on.
    ///
    /// # Errors
    /// [`StageError`].
    pub fn hold(&mut self, on: bool) -> Result<(), StageError> {
        for link in self.boards_mut() {
            link.request(if on { Request::Hold } else { Request::Resume })?;
        }
        Ok(())
    }

    /// Lets motions go on for so long, or until all are over by themselves or `keep_on` says no.
    ///
    /// # Errors
    /// [`StageError`]; [`LinkError::Stopped`] when one ended early.
    pub fn let_run(&mut self, motions: &[Begun], ms: u64, keep_on: &dyn Fn() -> bool) -> Result<(), StageError> {
        let mut pending = motions.to_vec();
        let end = later(self.now(), ms);
        while keep_on() {
            self.still_moving(&mut pending, &mut |_| {})?;
            let left_ms = end.0.saturating_sub(self.now().0) / 1000;
            if pending.is_empty() || left_ms == 0 {
                break;
            }
            self.listen(&pending, left_ms.min(super::POLL_MS), &mut |_| {})?;
        }
        Ok(())
    }

    fn begin_on(&mut self, name: AxisName, request: impl FnOnce(Axis) -> Request) -> Result<Begun, StageError> {
        let board = self.axes().find(|(known, _)| *known == name).map_or(0, |(_, place)| place.board);
        let (link, axis) = self.find(name)?;
        match link.request(request(axis))? {
            Response::Moving { motion } => Ok((board, motion)),
            _ => Err(LinkError::OutOfTurn { port: link.port() }.into()),
        }
    }
}
