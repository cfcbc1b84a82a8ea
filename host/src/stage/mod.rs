//! The axes of a rig by their names, whichever boards they are on.

mod motions;

use crate::link::transport::later;
use crate::link::{Link, LinkError};
use crate::rig::AxisName;
use parfocal_protocol::message::{Event, MotionId, Request, Response, Role, Status, Stop};
use parfocal_protocol::settings::AxisSettings;
use parfocal_protocol::units::{Axis, HostTime, Micrometres, MicrometresPerSecond, PerAxis};
use std::collections::BTreeMap;
use thiserror::Error;

/// Where an axis is connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Which of the stage's boards.
    pub board: usize,
    /// Which of the board's axes.
    pub axis: Axis,
}

/// Why an axis did not do what was asked.
#[derive(Debug, Error)]
pub enum StageError {
    /// The rig has no such axis.
    #[error("this rig has no axis {name}; it has {known}")]
    NoAxis {
        /// What was asked for.
        name: AxisName,
        /// What there is.
        known: String,
    },
    /// A position that no stage has.
    #[error("{name}: {at} µm is no position a stage can have")]
    NoPosition {
        /// The axis.
        name: AxisName,
        /// What was asked for.
        at: f64,
    },
    /// The end of the move lies beyond the axis' limits.
    #[error(
        "{name} may only go from {low} to {high} µm, not to {at}: choose a position in between, or change the limits with `parfocal settings set`"
    )]
    BeyondLimit {
        /// The axis.
        name: AxisName,
        /// What was asked for, µm.
        at: f64,
        /// Lower limit, µm.
        low: f64,
        /// Upper limit, µm.
        high: f64,
    },
    /// A person asked to stop.
    #[error("stopped on request; the axes decelerated and know where they are")]
    Interrupted,
    /// The board or the way to it.
    #[error(transparent)]
    Link(#[from] LinkError),
}

/// A rig's axes.
pub struct Stage {
    boards: Vec<Link>,
    axes: BTreeMap<AxisName, Place>,
}

/// How often the boards are asked where they are while something moves: also keeps them from stopping for a lost host.
const POLL_MS: u64 = 50;

impl Stage {
    /// The axes of `boards` by name.
    pub fn new(boards: Vec<Link>, axes: BTreeMap<AxisName, Place>) -> Self {
        Self { boards, axes }
    }

    /// The names of all axes, in order.
    pub fn axes(&self) -> impl Iterator<Item = (AxisName, Place)> + '_ {
        self.axes.iter().map(|(name, place)| (*name, *place))
    }

    /// The boards.
    pub fn boards_mut(&mut self) -> &mut [Link] {
        &mut self.boards
    }

    /// The clock of the first board's link: all links of a rig share one.
    pub fn now(&self) -> HostTime {
        self.boards.first().map_or(HostTime(0), Link::now)
    }

    /// An axis' board and its number there.
    ///
    /// # Errors
    /// [`StageError::NoAxis`] lists the axes that there are.
    pub fn find(&mut self, name: AxisName) -> Result<(&mut Link, Axis), StageError> {
        let known = || self.axes.keys().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        let place = *self.axes.get(&name).ok_or_else(|| StageError::NoAxis { name, known: known() })?;
        let link = self.boards.get_mut(place.board).ok_or_else(|| StageError::NoAxis { name, known: String::new() })?;
        Ok((link, place.axis))
    }

    /// Where an axis is.
    ///
    /// # Errors
    /// [`StageError`].
    pub fn position(&mut self, name: AxisName) -> Result<Micrometres, StageError> {
        let (link, axis) = self.find(name)?;
        let status = status(link)?;
        Ok(axis.index().map_or(Micrometres(f64::NAN), |i| status.axes[i].position.micrometres()))
    }

    /// An axis' settings.
    ///
    /// # Errors
    /// [`StageError`].
    pub fn settings(&mut self, name: AxisName) -> Result<AxisSettings, StageError> {
        let (link, axis) = self.find(name)?;
        match link.request(Request::GetAxis { axis })? {
            Response::Axis(settings) => Ok(settings),
            _ => Err(LinkError::OutOfTurn { port: link.port() }.into()),
        }
    }

    /// Changes an axis' settings.
    ///
    /// # Errors
    /// [`StageError`]; the board names the field that is out of range.
    pub fn set_settings(&mut self, name: AxisName, settings: AxisSettings) -> Result<(), StageError> {
        let (link, axis) = self.find(name)?;
        link.request(Request::SetAxis { axis, settings })?;
        Ok(())
    }

    /// Begins straight lines to absolute positions, one on each board that is concerned, and waits for their ends.
    /// `keep_on` is asked all the while; false stops everything.
    ///
    /// # Errors
    /// [`StageError`]; nothing has moved when a target is refused before the first board began.
    pub fn move_to(
        &mut self,
        targets: &[(AxisName, Micrometres)],
        speed: Option<MicrometresPerSecond>,
        keep_on: &dyn Fn() -> bool,
    ) -> Result<(), StageError> {
        let begun = self.begin(targets, speed)?;
        self.wait(&begun, keep_on)
    }

    /// Begins straight lines to absolute positions, one on each board that is concerned: which motion on which board.
    ///
    /// # Errors
    /// [`StageError`]; nothing has moved when a target is refused before the first board began.
    pub fn begin(
        &mut self,
        targets: &[(AxisName, Micrometres)],
        speed: Option<MicrometresPerSecond>,
    ) -> Result<Vec<(usize, MotionId)>, StageError> {
        let mut lines: BTreeMap<usize, PerAxis<Option<_>>> = BTreeMap::new();
        for (name, at) in targets {
            let target = at.nanometres().ok_or(StageError::NoPosition { name: *name, at: at.0 })?;
            let settings = self.settings(*name)?;
            if target < settings.low || target > settings.high {
                let (low, high) = (settings.low.micrometres().0, settings.high.micrometres().0);
                return Err(StageError::BeyondLimit { name: *name, at: at.0, low, high });
            }
            let place = self.axes[name];
            if let Some(i) = place.axis.index() {
                lines.entry(place.board).or_default()[i] = Some(target);
            }
        }
        let mut begun = Vec::new();
        for (board, to) in lines {
            match self.boards[board].request(Request::Move { to, speed }) {
                Ok(Response::Moving { motion }) => begun.push((board, motion)),
                Ok(_) => {}
                Err(error) => {
                    self.stop(Stop::Decelerate);
                    return Err(error.into());
                }
            }
        }
        Ok(begun)
    }

    /// Waits until motions are over: last edge out, settled.
    ///
    /// # Errors
    /// [`LinkError::Stopped`] when one ended early, [`StageError::Interrupted`] when `keep_on` said so.
    pub fn wait(&mut self, motions: &[(usize, MotionId)], keep_on: &dyn Fn() -> bool) -> Result<(), StageError> {
        self.wait_telling(motions, keep_on, &mut |_| {})
    }

    /// As [`Self::wait`], and hands over what the boards tell meanwhile.
    ///
    /// # Errors
    /// As [`Self::wait`].
    pub fn wait_telling(
        &mut self,
        motions: &[(usize, MotionId)],
        keep_on: &dyn Fn() -> bool,
        told: &mut dyn FnMut(Event),
    ) -> Result<(), StageError> {
        let mut pending = motions.to_vec();
        loop {
            if !keep_on() {
                self.stop(Stop::Decelerate);
                return Err(StageError::Interrupted);
            }
            // Every board is asked each time: one that hears nothing stops by itself.
            if let Err(error) = self.still_moving(&mut pending, told) {
                // The other boards know nothing of it.
                self.stop(Stop::Decelerate);
                return Err(error);
            }
            if pending.is_empty() {
                return Ok(());
            }
            self.listen(&pending, POLL_MS, told)?;
        }
    }

    /// Keeps of these motions those that are not over.
    ///
    /// # Errors
    /// [`LinkError::Stopped`] when one ended early.
    fn still_moving(
        &mut self,
        motions: &mut Vec<(usize, MotionId)>,
        told: &mut dyn FnMut(Event),
    ) -> Result<(), StageError> {
        let mut going = Vec::new();
        for (board, motion) in motions.drain(..) {
            let link = &mut self.boards[board];
            let status = status(link)?;
            if let (true, Some(cause)) = (status.motion == motion, status.stopped) {
                return Err(LinkError::Stopped(cause).into());
            }
            if status.motion > motion || status.in_position {
                // What was told before the status came in counts, too.
                let now = link.now();
                while let Some(event) = link.event(now)? {
                    told(event);
                }
            } else {
                going.push((board, motion));
            }
        }
        *motions = going;
        Ok(())
    }

    /// Takes what the boards of these motions tell, for so long.
    fn listen(
        &mut self,
        motions: &[(usize, MotionId)],
        ms: u64,
        told: &mut dyn FnMut(Event),
    ) -> Result<(), StageError> {
        let until = later(self.now(), ms);
        for (board, _) in motions {
            while let Some(event) = self.boards[*board].event(until)? {
                told(event);
            }
        }
        Ok(())
    }

    /// Stops everything on every board. What cannot be reached stops by itself: its host is lost.
    pub fn stop(&mut self, how: Stop) -> usize {
        self.boards.iter_mut().filter_map(|link| link.request(Request::Stop { how }).ok()).count()
    }

    /// Ends all sessions.
    pub fn close(self) {
        for link in self.boards {
            link.close();
        }
    }
}

/// How a board is.
///
/// # Errors
/// As [`Link::request`].
pub fn status(link: &mut Link) -> Result<Status, LinkError> {
    match link.request(Request::Status)? {
        Response::Status(status) => Ok(status),
        _ => Err(LinkError::OutOfTurn { port: link.port() }),
    }
}

/// The role for looking at a board, or for moving it.
pub fn role(control: bool, take: bool) -> Role {
    match (control, take) {
        (false, _) => Role::Watch,
        (true, false) => Role::Control,
        (true, true) => Role::TakeControl,
    }
}
