//! A whole virtual rig in virtual time. Nothing happens by itself: time passes while somebody waits.

use crate::board::VirtualBoard;
use crate::camera::{FrameTimes, VirtualCamera};
use crate::model::{ObjectiveModel, RigModel};
use crate::scene::{Exposure, Frame, Light, Pipette, Region, Scene, Viewpoint};
use parfocal_protocol::units::{Axis, Micrometres};

/// Steps in which boards live while one of them is busy, µs.
const TICK_US: u64 = 250;

/// Steps in which they live while none is.
const IDLE_US: u64 = 1000;

/// A frame that was exposed and not rendered yet.
#[derive(Clone, Debug)]
pub struct Shot {
    scene: Scene,
    view: Viewpoint,
    exposure: Exposure,
}

impl Shot {
    /// The picture.
    pub fn render(&self) -> Frame {
        self.scene.render(&self.view, &self.exposure)
    }

    /// A part of it, with the same values; `None` when the picture does not have that part.
    pub fn render_part(&self, part: Region) -> Option<Frame> {
        let within =
            |first: usize, size: usize, all: usize| size > 0 && first.checked_add(size).is_some_and(|end| end <= all);
        (within(part.x, part.width, self.view.width) && within(part.y, part.height, self.view.height))
            .then(|| self.scene.render_region(&self.view, &self.exposure, part))
    }
}

/// A virtual rig.
pub struct Rig {
    model: RigModel,
    now: u64,
    boards: Vec<VirtualBoard>,
    camera: VirtualCamera,
    scene: Scene,
    objective: usize,
    pending: Option<FrameTimes>,
}

impl Rig {
    /// A rig that has just been switched on.
    pub fn new(model: RigModel) -> Self {
        let boards = model
            .boards
            .iter()
            .enumerate()
            .map(|(i, board)| VirtualBoard::new(i, board, model.link_us, model.seed))
            .collect();
        let camera = VirtualCamera::new(model.camera.timing, model.seed);
        let scene = Scene { light: Light { vignetting: 0.08, slope: [0.02, -0.01] }, ..Scene::default() };
        Self { model, now: 0, boards, camera, scene, objective: 0, pending: None }
    }

    /// What it is made of.
    pub fn model(&self) -> &RigModel {
        &self.model
    }

    /// µs since it was switched on.
    pub fn now(&self) -> u64 {
        self.now
    }

    /// How many boards it has.
    pub fn boards(&self) -> usize {
        self.boards.len()
    }

    /// A board, for tests that look behind the protocol.
    pub fn board_mut(&mut self, board: usize) -> Option<&mut VirtualBoard> {
        self.boards.get_mut(board)
    }

    /// What lies under the microscope besides the pipettes; cells and debris may be put there.
    pub fn scene_mut(&mut self) -> &mut Scene {
        &mut self.scene
    }

    /// The objective in the light path.
    pub fn objective(&self) -> Option<&ObjectiveModel> {
        self.model.objectives.get(self.objective)
    }

    /// Turns the turret; false when it has no such objective.
    pub fn set_objective(&mut self, name: &str) -> bool {
        let place = self.model.objectives.iter().position(|o| o.name == name);
        self.objective = place.unwrap_or(self.objective);
        place.is_some()
    }

    /// Bytes from a program to a board.
    pub fn send(&mut self, board: usize, bytes: &[u8]) {
        let now = self.now;
        if let Some(board) = self.boards.get_mut(board) {
            board.send(now, bytes);
        }
    }

    /// Bytes from a board to a program, waiting for some until `deadline` µs. How many there were.
    pub fn receive(&mut self, board: usize, buffer: &mut [u8], deadline: u64) -> usize {
        loop {
            let now = self.now;
            let Some(source) = self.boards.get_mut(board) else { return 0 };
            let n = source.receive(now, buffer);
            if n > 0 || now >= deadline {
                return n;
            }
            self.step(deadline);
        }
    }

    /// Lets time pass until `until` µs.
    pub fn advance(&mut self, until: u64) {
        while self.now < until {
            self.step(until);
        }
    }

    /// The next frame, waiting for it until `deadline` µs. It shows the world at the middle of its exposure.
    pub fn next_frame(&mut self, deadline: u64) -> Option<(FrameTimes, Frame)> {
        self.next_shot(deadline).map(|(times, shot)| (times, shot.render()))
    }

    /// The next frame as what it is going to show: rendering it takes time in which the rig may live on.
    pub fn next_shot(&mut self, deadline: u64) -> Option<(FrameTimes, Shot)> {
        let times = self.next_times(deadline)?;
        let shot = self.shot(&times);
        Some((times, shot))
    }

    /// As [`Rig::next_frame`], without drawing what it shows.
    pub fn next_times(&mut self, deadline: u64) -> Option<FrameTimes> {
        let times = match self.pending.take() {
            Some(times) => times,
            None => self.camera.next_frame(self.now),
        };
        self.advance(times.arrival.min(deadline));
        if times.arrival > self.now {
            self.pending = Some(times);
            return None;
        }
        Some(times)
    }

    /// A region around the tip of manipulator `n` (from 0) in the picture, if it is in view.
    pub fn tip_region(&self, n: usize) -> Option<Region> {
        let view = self.viewpoint(self.now);
        let tip = self.pipettes(self.now).get(n)?.tip_um;
        let [x, y] = view.picture_px([tip[0], tip[1]])?;
        let side = 48;
        let (left, top) = (x.round() - f64::from(side) / 2.0, y.round() - f64::from(side) / 2.0);
        let fits = |from: f64, size: usize| from >= 0.0 && from + f64::from(side) <= size as f64;
        let side = side as usize;
        (fits(left, view.width) && fits(top, view.height)).then_some(Region {
            x: left as usize,
            y: top as usize,
            width: side,
            height: side,
        })
    }

    /// Where an axis' carriage truly was at `at` µs.
    pub fn truth(&self, board: usize, axis: Axis, at: u64) -> Micrometres {
        let known = self.boards.get(board).zip(axis.index()).map(|(board, axis)| board.carriage(axis, at));
        known.unwrap_or(Micrometres(0.0))
    }

    /// Where an axis' motor stands, by the steps that its driver saw.
    pub fn motor(&mut self, board: usize, axis: Axis) -> Micrometres {
        let known = self.boards.get_mut(board).zip(axis.index()).map(|(board, axis)| board.motor(axis));
        known.unwrap_or(Micrometres(0.0))
    }

    fn positions(&self, board: usize, at: u64) -> [f64; 3] {
        std::array::from_fn(|i| self.truth(board, Axis(i as u8), at).0)
    }

    /// What the microscope looks at, at a time.
    pub fn viewpoint(&self, at: u64) -> Viewpoint {
        let [x, y, z] = self.positions(0, at);
        let camera = &self.model.camera;
        let level = |x, y, z| Viewpoint::level([x, y], z, 1.0, camera.width, camera.height);
        let Some(objective) = self.objective() else {
            return Viewpoint { matrix_um_per_px: camera.matrix_um_per_px, ..level(x, y, z) };
        };
        let [kx, ky, kz] = objective.kappa_um;
        let matrix_um_per_px = camera.matrix_um_per_px.map(|row| row.map(|a| objective.alpha * a));
        Viewpoint { matrix_um_per_px, optics: objective.optics, ..level(x + kx, y + ky, z + kz) }
    }

    /// The pipettes where their manipulators hold them, at a time.
    pub fn pipettes(&self, at: u64) -> Vec<Pipette> {
        let held = |(i, manipulator): (usize, &crate::model::ManipulatorModel)| Pipette {
            tip_um: manipulator.tip(self.positions(i + 1, at)),
            azimuth_rad: manipulator.azimuth_rad,
            descent_rad: manipulator.descent_rad,
            opening_radius_um: 1.0,
            half_angle_rad: 0.09,
            contrast: 0.12,
        };
        self.model.manipulators.iter().enumerate().map(held).collect()
    }

    fn shot(&mut self, times: &FrameTimes) -> Shot {
        let at = times.middle();
        self.scene.pipettes = self.pipettes(at);
        let camera = &self.model.camera;
        let exposure = Exposure {
            level: 0.5,
            shot_noise: camera.shot_noise,
            read_noise: camera.read_noise,
            seed: self.model.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(times.number),
        };
        Shot { scene: self.scene.clone(), view: self.viewpoint(at), exposure }
    }

    fn step(&mut self, until: u64) {
        let tick = if self.boards.iter().any(VirtualBoard::is_busy) { TICK_US } else { IDLE_US };
        self.now = (self.now + tick).min(until);
        for board in &mut self.boards {
            board.live(self.now);
        }
    }
}
