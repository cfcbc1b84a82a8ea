//! The simulated rig as a procedure sees it: real boards in virtual time, and stand-ins for eyes that know the truth but for
//! a little noise. Nothing is rendered.

use parfocal::frames::camera::{Camera, CameraError, Frame};
use parfocal::link::transport::Transport;
use parfocal::link::{Link, LinkOptions};
use parfocal::picture::Picture;
use parfocal::procedure::{
    FocusTask, Focuser, Found, FramePixel, Hint, NotFound, PointFinder, ProcedureError, Subject, Witness,
};
use parfocal::rig::{AxisName, Coordinate, Device, ManipulatorNumber, Rig};
use parfocal::stage::{Place, Stage};
use parfocal_protocol::message::{Role, Session};
use parfocal_protocol::units::{Axis, HostTime, Micrometres};
use parfocal_simulator::model::RigModel;
use parfocal_simulator::rig;
use parfocal_tests::rig_file::boards_and_axes;
use std::collections::BTreeMap;
use std::io;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

/// Small noise of its own (splitmix64, sum of uniforms): repeats with its seed.
pub struct Noise(u64);

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15))
    }

    /// 0 to 1.
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal, by the sum of twelve.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

#[derive(Clone)]
pub struct World(Arc<Mutex<rig::Rig>>);

pub fn axis(name: &str) -> AxisName {
    name.parse().unwrap()
}

pub fn m1() -> ManipulatorNumber {
    ManipulatorNumber::new(1).unwrap()
}

impl World {
    pub fn new(model: RigModel) -> Self {
        Self(Arc::new(Mutex::new(rig::Rig::new(model))))
    }

    pub fn lock(&self) -> MutexGuard<'_, rig::Rig> {
        self.0.lock().unwrap()
    }

    pub fn stage(&self) -> Stage {
        let boards = self.lock().boards();
        // A program that is begun again is another session.
        static SESSIONS: AtomicU32 = AtomicU32::new(77);
        let session = Session(SESSIONS.fetch_add(1, Ordering::Relaxed));
        let link = |board| {
            let transport = Box::new(Cable { world: self.clone(), board });
            Link::open(transport, session, Role::Control, LinkOptions::default()).unwrap()
        };
        let mut axes = BTreeMap::new();
        for board in 0..boards {
            let device = ManipulatorNumber::new(board as u8).map_or(Device::Scope, Device::Manipulator);
            for coordinate in Coordinate::ALL {
                axes.insert(AxisName { device, coordinate }, Place { board, axis: Axis(coordinate.index() as u8) });
            }
        }
        Stage::new((0..boards).map(link).collect(), axes)
    }

    pub fn camera(&self) -> Eye {
        Eye(self.clone())
    }

    /// Where the tip of manipulator `n` (from 0) is now, in ref.
    pub fn tip(&self, n: usize) -> [f64; 3] {
        let rig = self.lock();
        rig.pipettes(rig.now())[n].tip_um
    }

    /// What a pixel shows now, in ref.
    pub fn shown(&self, x: f64, y: f64) -> [f64; 2] {
        let rig = self.lock();
        rig.viewpoint(rig.now()).ref_um(x, y)
    }
}

struct Cable {
    world: World,
    board: usize,
}

impl Transport for Cable {
    fn name(&self) -> String {
        "virtual".into()
    }

    fn read(&mut self, buffer: &mut [u8], deadline: HostTime) -> io::Result<usize> {
        Ok(self.world.lock().receive(self.board, buffer, deadline.0))
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.world.lock().send(self.board, bytes);
        Ok(())
    }

    fn now(&self) -> HostTime {
        HostTime(self.world.lock().now())
    }

    fn reconnect(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A camera whose frames have the right size and times, and show nothing.
pub struct Eye(World);

impl Camera for Eye {
    fn name(&self) -> String {
        "virtual".into()
    }

    fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
        let mut rig = self.0.lock();
        let Some((times, _)) = rig.next_shot(deadline.0) else { return Ok(None) };
        let (w, h) = (rig.model().camera.width, rig.model().camera.height);
        Ok(Some(Frame {
            picture: Picture::grey8(w, h, vec![0; w * h]).unwrap().into(),
            number: times.number,
            exposure: Some((HostTime(times.begin), HostTime(times.end))),
            arrival: HostTime(times.arrival),
        }))
    }
}

/// Sees tips where they are, give or take some noise, when they are in the picture and not too far from focus.
pub struct TruthFinder {
    pub world: World,
    pub noise: Noise,
    pub sigma_px: f64,
    /// One in so many is somewhere else altogether; 0: none.
    pub astray: u32,
    /// From the so many'th look on nothing is seen.
    pub blind_after: usize,
    pub looks: usize,
}

/// A detector still sees a tip this far from focus, µm.
const BLURRED_UM: f64 = 20.0;

impl TruthFinder {
    pub fn new(world: &World, seed: u64) -> Self {
        Self {
            world: world.clone(),
            noise: Noise::new(seed),
            sigma_px: 0.3,
            astray: 0,
            blind_after: usize::MAX,
            looks: 0,
        }
    }
}

impl PointFinder for TruthFinder {
    fn find(&mut self, frame: &Frame, hint: &Hint) -> Result<Found, NotFound> {
        let unseen = || NotFound::Unseen(hint.subject.clone());
        let (begin, end) = frame.exposure.unwrap();
        let at = (begin.0 + end.0) / 2;
        let n = match hint.subject {
            Subject::Tip(n) => usize::from(n.get()) - 1,
            _ => 0,
        };
        self.looks += 1;
        let (pixel, off_focus) = {
            let rig = self.world.lock();
            let (tip, view) = (rig.pipettes(at)[n].tip_um, rig.viewpoint(at));
            (view.picture_px([tip[0], tip[1]]).unwrap(), tip[2] - view.focus_um)
        };
        let (w, h) = (frame.picture.width as f64, frame.picture.height as f64);
        let inside = pixel[0] > 4.0 && pixel[0] < w - 5.0 && pixel[1] > 4.0 && pixel[1] < h - 5.0;
        if !inside || off_focus.abs() > BLURRED_UM || self.looks > self.blind_after {
            return Err(unseen());
        }
        let mut place = FramePixel {
            x_px: pixel[0] + self.sigma_px * self.noise.normal(),
            y_px: pixel[1] + self.sigma_px * self.noise.normal(),
        };
        if self.astray > 0 && self.noise.uniform() < 1.0 / f64::from(self.astray) {
            // Half of them not far off, half anywhere.
            let reach = if self.noise.uniform() < 0.5 { 25.0 } else { 200.0 };
            place.x_px = (place.x_px + reach * self.noise.normal()).clamp(0.0, w - 1.0);
            place.y_px = (place.y_px + reach * self.noise.normal()).clamp(0.0, h - 1.0);
        }
        Ok(Found { at: place, confidence: 0.9, angle_deg: None, by: Witness::Detector })
    }
}

/// Moves the axis to where the tip in the region is in focus, give or take some noise.
pub struct TruthFocuser {
    pub world: World,
    pub noise: Noise,
    pub sigma_um: f64,
    /// Refuses one time in so many; 0: never.
    pub refuses: u32,
}

impl TruthFocuser {
    pub fn new(world: &World, seed: u64) -> Self {
        Self { world: world.clone(), noise: Noise::new(seed ^ 0xf0c5), sigma_um: 0.3, refuses: 0 }
    }
}

impl Focuser for TruthFocuser {
    fn focus(
        &mut self,
        stage: &mut Stage,
        _camera: &mut dyn Camera,
        task: &FocusTask,
        keep_on: &dyn Fn() -> bool,
    ) -> Result<Micrometres, ProcedureError> {
        let refused = |reason| Err(ProcedureError::NotFocused { axis: task.axis, reason });
        if self.refuses > 0 && self.noise.uniform() < 1.0 / f64::from(self.refuses) {
            return refused("no significant peak");
        }
        let middle = |start: usize, size: usize| start as f64 + (size as f64 - 1.0) / 2.0;
        let (x, y) = (middle(task.region.x, task.region.width), middle(task.region.y, task.region.height));
        let here = stage.position(task.axis)?.0;
        let best = {
            let rig = self.world.lock();
            let view = rig.viewpoint(rig.now());
            rig.pipettes(rig.now())
                .iter()
                .filter_map(|p| {
                    let [px, py] = view.picture_px([p.tip_um[0], p.tip_um[1]])?;
                    let half = task.region.width as f64 / 2.0 + 2.0;
                    ((px - x).abs() <= half && (py - y).abs() <= half).then_some(here + p.tip_um[2] - view.focus_um)
                })
                .next()
        };
        let Some(best) = best else { return refused("no contrast") };
        let at = best + self.sigma_um * self.noise.normal();
        if at < task.low.0 + 1.0 || at > task.high.0 - 1.0 {
            return refused("peak at the edge of the range");
        }
        stage.move_to(&[(task.axis, Micrometres(at))], None, keep_on)?;
        Ok(Micrometres(at))
    }
}

/// The simulated rig's file, nothing calibrated.
pub fn rig_file() -> Rig {
    let mut text = String::from("schema = 1\nobjective_in_use = \"40x\"\n");
    text += "[objectives.40x]\ndefault = true\n[objectives.20x]\ndepth_of_field_um = 2.6\n";
    text += "[camera]\nwidth_px = 640\nheight_px = 480\n";
    text += &boards_and_axes();
    Rig::parse(&text).unwrap()
}
