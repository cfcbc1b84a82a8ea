//! Moves that are looked at before they are made: soft limits, and every tip on its whole way against every obstacle.

use super::error::ProcedureError;
use super::obstacles::{self, Sight, Way};
use crate::calibration::chain::{Arm, ChainError};
use crate::calibration::frames::{Displacement, Man, Point, Ref};
use crate::rig::{AxisName, Coordinate, Device, ManipulatorNumber, Moves, Obstacle, Rig};
use crate::stage::{Stage, StageError, status};
use nalgebra::Vector3;
use parfocal_protocol::message::Trust;
use parfocal_protocol::units::{HostTime, Micrometres};
use std::collections::BTreeMap;

/// Where to send axes.
pub type Targets = Vec<(AxisName, Micrometres)>;

/// The position of everything at one moment, by its axes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pose {
    positions: BTreeMap<AxisName, f64>,
}

impl Pose {
    /// An axis' position; 0 for an axis that the rig does not have.
    pub fn axis(&self, name: AxisName) -> Micrometres {
        Micrometres(self.positions.get(&name).copied().unwrap_or(0.0))
    }

    /// x, y and z of a device, µm; 0 for axes it does not have.
    pub fn device(&self, device: Device) -> Vector3<f64> {
        Vector3::from(Coordinate::ALL.map(|coordinate| self.axis(AxisName { device, coordinate }).0))
    }

    /// A manipulator's joint position.
    pub fn joints(&self, number: ManipulatorNumber) -> Point<Man> {
        self.device(Device::Manipulator(number)).into()
    }

    /// P_M: the microscope's axes that move the objective, µm. Axes that move the sample do not count.
    pub fn microscope(&self, rig: &Rig) -> Vector3<f64> {
        Vector3::from(Coordinate::ALL.map(|coordinate| {
            let name = AxisName { device: Device::Scope, coordinate };
            if moves_sample(rig, name) { 0.0 } else { self.axis(name).0 }
        }))
    }

    /// The pose after these moves.
    #[must_use]
    pub fn with(&self, targets: &[(AxisName, Micrometres)]) -> Self {
        let mut pose = self.clone();
        pose.positions.extend(targets.iter().map(|(name, at)| (*name, at.0)));
        pose
    }
}

/// Whether an axis of the microscope moves the sample. Without a word in the rig's file it moves the objective.
pub fn moves_sample(rig: &Rig, name: AxisName) -> bool {
    rig.axis(name).and_then(|axis| axis.moves) == Some(Moves::Stage)
}

/// The three axes of a device, with positions, µm.
pub fn targets(device: Device, to: Vector3<f64>) -> Targets {
    Coordinate::ALL.map(|c| (AxisName { device, coordinate: c }, Micrometres(to[c.index()]))).into()
}

/// What is known of where a tip is.
#[derive(Clone, Copy, Debug)]
enum Tip {
    /// By a registration, or one in the making, which may be wrong by some µm.
    Registered { arm: Arm, error_um: f64 },
    /// It was seen at a place with the joints at a position; how it moves from there is not known.
    Seen { at: Point<Ref>, joints: Point<Man> },
}

/// No manipulator moves its tip farther than this for each µm of a joint: for tips whose registration is not known.
const LONGEST: f64 = 1.3;

/// How far up from the tip a pipette's axis is looked at, µm, where its direction is known.
const SHANK_UM: f64 = 3000.0;

/// A stage whose moves are looked at before they are made.
pub struct Guard<'a> {
    stage: &'a mut Stage,
    rig: &'a Rig,
    keep_on: &'a dyn Fn() -> bool,
    tips: BTreeMap<ManipulatorNumber, Tip>,
    in_use: Option<String>,
    moved: HostTime,
}

impl<'a> Guard<'a> {
    /// Guards `stage` by what `rig` says. `keep_on` is asked while something moves; false stops everything.
    pub fn new(stage: &'a mut Stage, rig: &'a Rig, keep_on: &'a dyn Fn() -> bool) -> Self {
        let known = |n: &ManipulatorNumber| {
            let fine = Arm::of(rig, *n).ok().map(|arm| Tip::Registered { arm, error_um: 0.0 });
            // By markers alone: obstacles are kept clear of by three standard deviations more.
            let coarse = || Arm::coarse_of(rig, *n).map(|(arm, sd)| Tip::Registered { arm, error_um: 3.0 * sd });
            Some((*n, fine.or_else(coarse)?))
        };
        let tips = rig.contents().manipulators.keys().filter_map(known).collect();
        let moved = stage.now();
        let in_use = rig.contents().objective_in_use.clone();
        Self { stage, rig, keep_on, tips, in_use, moved }
    }

    /// The stage.
    pub fn stage(&mut self) -> &mut Stage {
        self.stage
    }

    /// The rig's file.
    pub fn rig(&self) -> &'a Rig {
        self.rig
    }

    /// The objective in the light path, if anybody said.
    pub fn objective(&self) -> Option<&str> {
        self.in_use.as_deref()
    }

    /// Another objective is in the light path from now on.
    pub fn set_objective(&mut self, name: &str) {
        self.in_use = Some(name.into());
        self.moved_now();
    }

    /// False when a person asked to stop.
    pub fn keep_on(&self) -> bool {
        (self.keep_on)()
    }

    /// When the last move had ended, by the host's clock: what was exposed before shows the past.
    pub fn moved(&self) -> HostTime {
        self.moved
    }

    /// Everything that was shown before now is the past.
    pub fn moved_now(&mut self) {
        self.moved = self.stage.now();
    }

    /// The stage and the question whether to go on, for what drives the stage itself (a scan).
    pub fn parts(&mut self) -> (&mut Stage, &'a dyn Fn() -> bool) {
        (self.stage, self.keep_on)
    }

    /// Whether the rig has an axis.
    pub fn has(&self, name: AxisName) -> bool {
        self.stage.axes().any(|(known, _)| known == name)
    }

    /// From now on this is how a manipulator's joints move its tip: a registration in the making.
    pub fn assume(&mut self, number: ManipulatorNumber, arm: Arm) {
        self.assume_within(number, arm, 0.0);
    }

    /// As [`Self::assume`], for a registration that may be wrong by `error_um`: obstacles are kept clear of by as much more.
    pub fn assume_within(&mut self, number: ManipulatorNumber, arm: Arm, error_um: f64) {
        self.tips.insert(number, Tip::Registered { arm, error_um });
    }

    /// The tip was seen at a place with the joints at a position: all that is known of a manipulator not registered.
    /// A registered one keeps its registration.
    pub fn seen(&mut self, number: ManipulatorNumber, at: Point<Ref>, joints: Point<Man>) {
        self.tips.entry(number).or_insert(Tip::Seen { at, joints });
    }

    /// Whether anything is known of where a manipulator's tip is.
    pub fn knows(&self, number: ManipulatorNumber) -> bool {
        self.tips.contains_key(&number)
    }

    /// Where everything is.
    ///
    /// # Errors
    /// [`StageError`] when a board does not answer.
    pub fn pose(&mut self) -> Result<Pose, StageError> {
        let places: Vec<_> = self.stage.axes().collect();
        let boards = self.stage.boards_mut().iter_mut().map(status).collect::<Result<Vec<_>, _>>()?;
        let at = |(name, place): (AxisName, crate::stage::Place)| {
            let axis = boards.get(place.board)?.axes.get(place.axis.index()?)?;
            Some((name, axis.position.micrometres().0))
        };
        Ok(Pose { positions: places.into_iter().filter_map(at).collect() })
    }

    /// Refuses devices whose position the board itself does not trust.
    ///
    /// # Errors
    /// [`ProcedureError::Untrusted`] names the axis.
    pub fn trusted(&mut self, devices: &[Device]) -> Result<(), ProcedureError> {
        let places: Vec<_> = self.stage.axes().filter(|(name, _)| devices.contains(&name.device)).collect();
        let boards: Vec<_> =
            self.stage.boards_mut().iter_mut().map(status).collect::<Result<_, _>>().map_err(StageError::from)?;
        for (name, place) in places {
            let axis = place.axis.index().and_then(|i| boards.get(place.board)?.axes.get(i));
            if axis.is_some_and(|axis| axis.trust == Trust::Lost) {
                return Err(ProcedureError::Untrusted(name));
            }
        }
        Ok(())
    }

    /// Whether a move is within soft limits and leads no tip into an obstacle, from where everything is now.
    ///
    /// # Errors
    /// The limit or the obstacle that is in the way.
    pub fn check(&mut self, targets: &[(AxisName, Micrometres)]) -> Result<(), ProcedureError> {
        let from = self.pose()?;
        self.check_from(&from, targets)
    }

    /// As [`Self::check`], from a pose.
    ///
    /// # Errors
    /// The limit or the obstacle that is in the way.
    pub fn check_from(&mut self, from: &Pose, targets: &[(AxisName, Micrometres)]) -> Result<(), ProcedureError> {
        let mut overshoot: BTreeMap<Device, f64> = BTreeMap::new();
        for (name, at) in targets {
            let target = at.nanometres().ok_or(StageError::NoPosition { name: *name, at: at.0 })?;
            let settings = self.stage.settings(*name)?;
            if target < settings.low || target > settings.high {
                let (low, high) = (settings.low.micrometres().0, settings.high.micrometres().0);
                return Err(StageError::BeyondLimit { name: *name, at: at.0, low, high }.into());
            }
            if settings.approach.is_some() {
                // A move that ends from a given side goes past its end and comes back (firmware, motion::backlash).
                *overshoot.entry(name.device).or_default() += OVERSHOOT_UM + settings.backlash.micrometres().0;
            }
        }
        self.check_obstacles(from, targets, &overshoot)
    }

    fn check_obstacles(
        &self,
        from: &Pose,
        targets: &[(AxisName, Micrometres)],
        overshoot: &BTreeMap<Device, f64>,
    ) -> Result<(), ProcedureError> {
        let contents = self.rig.contents();
        if contents.obstacles.is_empty() {
            return Ok(());
        }
        let in_use = self.objective();
        if in_use.is_none() && contents.obstacles.iter().any(|o| matches!(o, Obstacle::Cone { .. })) {
            return Err(ChainError::NoObjective.into());
        }
        let to = from.with(targets);
        let around = |device: Device| overshoot.get(&device).copied().unwrap_or(0.0);
        let axis = Displacement::<Ref>::from(kappa(self.rig, in_use));
        let sight = Sight {
            from: Point::from(from.microscope(self.rig)) + axis,
            to: Point::from(to.microscope(self.rig)) + axis,
            around_um: around(Device::Scope),
        };
        let devices: Vec<Device> = self.stage.axes().map(|(name, _)| name.device).collect();
        let mut numbers: Vec<ManipulatorNumber> = self.tips.keys().copied().collect();
        numbers.retain(|n| devices.contains(&Device::Manipulator(*n)));
        for (name, _) in targets {
            if let Device::Manipulator(n) = name.device
                && !self.tips.contains_key(&n)
            {
                return Err(ProcedureError::TipUnknown(n));
            }
        }
        for n in numbers {
            let way = self.way(n, from, &to, LONGEST * around(Device::Manipulator(n)));
            obstacles::check(&contents.obstacles, in_use, n, &way, &sight)?;
        }
        Ok(())
    }

    fn way(&self, n: ManipulatorNumber, from: &Pose, to: &Pose, around_um: f64) -> Way {
        let (start, end) = (from.joints(n), to.joints(n));
        let nothing = Displacement::<Ref>::new(0.0, 0.0, 0.0);
        match self.tips[&n] {
            Tip::Registered { arm, error_um } => {
                let around_um = around_um + error_um;
                let shank = arm.direction().map_or(nothing, |advance| -SHANK_UM * advance);
                Way { from: arm.tip(start), to: arm.tip(end), around_um, around_now_um: around_um, shank }
            }
            Tip::Seen { at, joints } => {
                let reach = |p: Point<Man>| LONGEST * (p - joints).coordinates.abs().sum();
                let now = reach(start);
                let around_now_um = around_um + now;
                Way { from: at, to: at, around_um: around_um + now.max(reach(end)), around_now_um, shank: nothing }
            }
        }
    }

    /// Moves in straight lines, one a board, after [`Self::check`]. Nothing has moved when it refuses.
    ///
    /// # Errors
    /// As [`Self::check`], and whatever stopped the move.
    pub fn move_to(&mut self, targets: &[(AxisName, Micrometres)]) -> Result<(), ProcedureError> {
        self.check(targets)?;
        let moved = self.stage.move_to(targets, None, self.keep_on);
        self.moved = self.stage.now();
        Ok(moved?)
    }
}

/// As the firmware's `motion::backlash::OVERSHOOT_UM`; the link does not tell it.
const OVERSHOOT_UM: f64 = 1.0;

/// Where the objective in use looks, from where the default one does, µm; 0 while it is not known.
fn kappa(rig: &Rig, in_use: Option<&str>) -> Vector3<f64> {
    let contents = rig.contents();
    let zoom = contents.zoom_in_use.unwrap_or(1.0);
    let objective = in_use.and_then(|name| contents.objectives.get(name));
    let entry = objective.and_then(|o| o.zooms.iter().find(|z| z.zoom == zoom));
    let kappa = entry.map_or(Vector3::zeros(), |entry| entry.kappa_um.into());
    kappa + Vector3::z() * contents.objective_height_um
}
