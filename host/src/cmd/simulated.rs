//! The simulated rig as this program's boards and camera: transports and frames out of one virtual world.

use super::remembered::{Memory, Remembered};
use parfocal::frames::camera::{Camera, CameraError, Frame, Stamp};
use parfocal::link::transport::Transport;
use parfocal::picture::{Picture, Roi};
use parfocal::rig::{AxisName, Coordinate, Device, ManipulatorNumber};
use parfocal::stage::Place;
use parfocal_protocol::units::{Axis, HostTime, Micrometres};
use parfocal_simulator::camera::{CameraTiming, FrameTimes};
use parfocal_simulator::model::{ObjectiveModel, RigModel};
use parfocal_simulator::rig::Rig;
use parfocal_simulator::scene::Region;
use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What is asked of the simulated rig.
#[derive(Clone, Debug, Default)]
pub struct Model {
    /// Seed of everything random.
    pub seed: u64,
    /// Limits of axes, other than the rig's own.
    pub limits: Vec<(AxisName, Micrometres, Micrometres)>,
    /// Where axes are at the start, other than the rig's own.
    pub positions: Vec<(AxisName, Micrometres)>,
    /// The camera's timing, other than the rig's own.
    pub timing: Option<CameraTiming>,
    /// The objective in the light path, other than its first.
    pub objective: Option<String>,
    /// How far manipulators were set down from where they were built in, in ref, µm.
    pub set_down: BTreeMap<ManipulatorNumber, [f64; 3]>,
    /// Where its axes' positions are kept from one command to the next.
    pub memory: Option<Memory>,
}

/// A running simulated rig. Time passes only while somebody waits for it.
#[derive(Clone)]
pub struct Handle(Arc<World>);

/// The virtual world, and what of it is remembered when it ends.
struct World {
    rig: Mutex<Rig>,
    set_down: BTreeMap<ManipulatorNumber, [f64; 3]>,
    memory: Option<Memory>,
}

impl Drop for World {
    fn drop(&mut self) {
        let Some(memory) = &self.memory else { return };
        let rig = self.rig.get_mut().unwrap_or_else(PoisonError::into_inner);
        let at = |(name, place): (AxisName, Place)| (name, rig.motor(place.board, place.axis));
        let positions = axes().into_iter().map(at).collect();
        let left = Remembered { positions, set_down: std::mem::take(&mut self.set_down) };
        if let Err(error) = memory.keep(&left) {
            eprintln!("parfocal: {error:#}");
        }
    }
}

/// Boards of the simulated rig by device: the microscope, manipulators 1 and 2.
fn devices() -> impl Iterator<Item = Device> {
    std::iter::once(Device::Scope).chain(manipulators().map(Device::Manipulator))
}

/// The simulated rig's manipulators.
pub fn manipulators() -> impl Iterator<Item = ManipulatorNumber> {
    [1, 2].into_iter().filter_map(ManipulatorNumber::new)
}

/// The simulated rig's axes.
pub fn axes() -> BTreeMap<AxisName, Place> {
    devices()
        .enumerate()
        .flat_map(|(board, device)| {
            Coordinate::ALL.map(|coordinate| {
                let axis = Axis(coordinate.index() as u8);
                (AxisName { device, coordinate }, Place { board, axis })
            })
        })
        .collect()
}

impl Handle {
    /// A simulated rig that has just been switched on.
    pub fn new(model: Model) -> Self {
        let mut rig = RigModel::new(model.seed);
        if let Some(timing) = model.timing {
            rig.camera.timing = timing;
        }
        let places = axes();
        for (name, low, high) in &model.limits {
            if let Some(place) = places.get(name) {
                rig.set_limits(place.board, place.axis, *low, *high);
            }
        }
        for (name, at) in &model.positions {
            if let Some(place) = places.get(name) {
                rig.set_position(place.board, place.axis, *at);
            }
        }
        for (number, held) in manipulators().zip(&mut rig.manipulators) {
            let by = model.set_down.get(&number).copied().unwrap_or_default();
            held.origin_um.iter_mut().zip(by).for_each(|(origin, by)| *origin += by);
        }
        rig.objectives.push(ObjectiveModel::SEARCHER);
        let mut rig = Rig::new(rig);
        if let Some(name) = &model.objective {
            rig.set_objective(name);
        }
        Self(Arc::new(World { rig: Mutex::new(rig), set_down: model.set_down, memory: model.memory }))
    }

    /// Turns the turret.
    ///
    /// # Errors
    /// The objectives that it has.
    pub fn set_objective(&self, name: &str) -> Result<(), String> {
        let mut rig = self.lock();
        if rig.set_objective(name) {
            return Ok(());
        }
        let known: Vec<&str> = rig.model().objectives.iter().map(|o| o.name).collect();
        Err(format!("the simulated microscope has no objective '{name}'; it has {}", known.join(", ")))
    }

    /// The rig's camera.
    pub fn camera(&self) -> SimulatedCamera {
        SimulatedCamera(self.clone())
    }

    /// A region around the first pipette's tip, if it is in view: what a person would draw around it.
    pub fn tip_region(&self) -> Option<Roi> {
        let region = self.lock().tip_region(0)?;
        Some(Roi { x: region.x, y: region.y, width: region.width, height: region.height })
    }

    /// The world itself.
    pub fn lock(&self) -> MutexGuard<'_, Rig> {
        // A panic elsewhere ends the program anyway.
        self.0.rig.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Simulated boards that links can be opened to.
pub trait Boards {
    /// One transport for each board.
    fn transports(&self) -> Vec<Box<dyn Transport>>;
}

impl Boards for Handle {
    fn transports(&self) -> Vec<Box<dyn Transport>> {
        let transport = |board| Box::new(SimulatedTransport { rig: self.clone(), board }) as Box<dyn Transport>;
        (0..self.lock().boards()).map(transport).collect()
    }
}

/// The way to one simulated board.
pub struct SimulatedTransport {
    rig: Handle,
    board: usize,
}

impl Transport for SimulatedTransport {
    fn name(&self) -> String {
        super::connection::SIMULATED.into()
    }

    fn read(&mut self, buffer: &mut [u8], deadline: HostTime) -> io::Result<usize> {
        Ok(self.rig.lock().receive(self.board, buffer, deadline.0))
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.rig.lock().send(self.board, bytes);
        Ok(())
    }

    fn now(&self) -> HostTime {
        HostTime(self.rig.lock().now())
    }

    fn reconnect(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The simulated camera.
pub struct SimulatedCamera(Handle);

impl Camera for SimulatedCamera {
    fn name(&self) -> String {
        super::connection::SIMULATED.into()
    }

    fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
        Ok(self.next_part(deadline, None)?.map(|(frame, _)| frame))
    }

    fn next_part(
        &mut self,
        deadline: HostTime,
        part: Option<Roi>,
    ) -> Result<Option<(Frame, Option<Roi>)>, CameraError> {
        let Some((times, shot)) = self.0.lock().next_shot(deadline.0) else { return Ok(None) };
        let region = |part: Roi| Region { x: part.x, y: part.y, width: part.width, height: part.height };
        // Drawing a whole picture to look at its tip costs a hundred times as much.
        let (drawn, left) = match part.and_then(|part| shot.render_part(region(part))) {
            Some(drawn) => (drawn, None),
            None => (shot.render(), part),
        };
        let picture = Picture::grey16(drawn.width, drawn.height, drawn.pixels)
            .map_err(|e| CameraError::Ended { camera: self.name(), reason: e.to_string() })?;
        let Stamp { number, exposure, arrival } = self.stamp(&times);
        Ok(Some((Frame { picture: picture.into(), number, exposure, arrival }, left)))
    }

    fn next_stamp(&mut self, deadline: HostTime) -> Result<Option<Stamp>, CameraError> {
        let times = self.0.lock().next_times(deadline.0);
        Ok(times.map(|times| self.stamp(&times)))
    }
}

impl SimulatedCamera {
    fn stamp(&self, times: &FrameTimes) -> Stamp {
        let told = self.0.lock().model().camera.timing.timestamps;
        Stamp {
            number: times.number,
            exposure: told.then_some((HostTime(times.begin), HostTime(times.end))),
            arrival: HostTime(times.arrival),
        }
    }
}
