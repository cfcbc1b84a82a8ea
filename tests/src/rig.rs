//! The simulated rig for tests of the host's library: a link to a board, and a camera on a target with one smooth peak.

use parfocal::frames::camera::{Camera, CameraError, Frame, Stamp};
use parfocal::link::transport::Transport;
use parfocal::link::{Link, LinkOptions};
use parfocal::picture::Picture;
use parfocal::rig::{AxisName, Coordinate, Device};
use parfocal::stage::{Place, Stage};
use parfocal_protocol::message::{Role, Session};
use parfocal_protocol::units::{Axis, HostTime, Micrometres};
use parfocal_simulator::camera::FrameTimes;
use parfocal_simulator::model::RigModel;
use parfocal_simulator::rig::Rig;
use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard};

/// A rig that several hands hold.
#[derive(Clone)]
pub struct Shared(Arc<Mutex<Rig>>);

impl Shared {
    /// A rig that has just been switched on.
    pub fn new(model: RigModel) -> Self {
        Self(Arc::new(Mutex::new(Rig::new(model))))
    }

    /// The world itself.
    ///
    /// # Panics
    /// When another hand panicked.
    pub fn lock(&self) -> MutexGuard<'_, Rig> {
        self.0.lock().expect("no other hand panicked")
    }

    /// A link in control of a board.
    ///
    /// # Panics
    /// When the board does not answer.
    pub fn link(&self, board: usize) -> Link {
        let cable = Cable { rig: self.clone(), board };
        Link::open(Box::new(cable), Session(board as u32 + 7), Role::Control, LinkOptions::default()).expect("a board")
    }

    /// The microscope's axes.
    pub fn stage(&self) -> Stage {
        let axes: BTreeMap<AxisName, Place> = Coordinate::ALL
            .into_iter()
            .map(|coordinate| {
                let place = Place { board: 0, axis: Axis(coordinate.index() as u8) };
                (AxisName { device: Device::Scope, coordinate }, place)
            })
            .collect();
        Stage::new(vec![self.link(0)], axes)
    }
}

struct Cable {
    rig: Shared,
    board: usize,
}

impl Transport for Cable {
    fn name(&self) -> String {
        "sim".into()
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

/// The simulated camera, its picture a chequered target whose Brenner measure is a peak over the true height of scope.z,
/// averaged over the exposure.
pub struct Target {
    /// The rig.
    pub rig: Shared,
    /// Φ at a true height, between 0 and 1.
    pub phi: Box<dyn FnMut(f64) -> f64 + Send>,
    /// Half the range of the noise of a pixel, grey levels.
    pub noise: u64,
    /// Whether the lamp is far too bright.
    pub glare: bool,
    /// Numbers of the frames delivered.
    pub delivered: Vec<u64>,
    /// State of the noise.
    pub random: u64,
}

/// Side of the target's picture, px.
const SIDE: usize = 16;

/// How often [`Target::phi`] is asked in an exposure.
pub const LOOKS: usize = 11;

/// A Gaussian of this FWHM, µm.
pub fn gaussian(at: f64, fwhm: f64) -> impl FnMut(f64) -> f64 + Send {
    let s = fwhm / 2.354_820_045;
    move |z| 0.1 + 0.8 * (-(z - at) * (z - at) / (2.0 * s * s)).exp()
}

impl Target {
    /// A target without noise.
    pub fn new(rig: &Shared, phi: impl FnMut(f64) -> f64 + Send + 'static) -> Self {
        Self { rig: rig.clone(), phi: Box::new(phi), noise: 0, glare: false, delivered: Vec::new(), random: 1 }
    }

    fn stamp(&self, times: &FrameTimes) -> Stamp {
        let told = self.rig.lock().model().camera.timing.timestamps;
        Stamp {
            number: times.number,
            exposure: told.then_some((HostTime(times.begin), HostTime(times.end))),
            arrival: HostTime(times.arrival),
        }
    }

    fn picture(&mut self, times: &FrameTimes) -> Picture {
        let mut phi = 0.0;
        for i in 0..LOOKS as u64 {
            let at = times.begin + (times.end - times.begin) * i / (LOOKS as u64 - 1);
            let z = self.rig.lock().truth(0, Axis(2), at).0;
            phi += (self.phi)(z) / LOOKS as f64;
        }
        if self.glare {
            return Picture::grey16(SIDE, SIDE, vec![u16::MAX; SIDE * SIDE]).expect("a picture");
        }
        // Brenner squares the difference of pixels two apart.
        let contrast = 20_000.0 * phi.max(0.0).sqrt();
        let pixel = |i: usize| {
            self.random = self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let noise = if self.noise > 0 {
                ((self.random >> 33) % (2 * self.noise + 1)) as f64 - self.noise as f64
            } else {
                0.0
            };
            let sign = if (i % SIDE / 2).is_multiple_of(2) { 0.5 } else { -0.5 };
            (30_000.0 + sign * contrast + noise).round() as u16
        };
        Picture::grey16(SIDE, SIDE, (0..SIDE * SIDE).map(pixel).collect()).expect("a picture")
    }
}

impl Camera for Target {
    fn name(&self) -> String {
        "target".into()
    }

    fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
        let Some(times) = self.rig.lock().next_times(deadline.0) else { return Ok(None) };
        self.delivered.push(times.number);
        let picture = self.picture(&times);
        let Stamp { number, exposure, arrival } = self.stamp(&times);
        Ok(Some(Frame { picture: picture.into(), number, exposure, arrival }))
    }

    fn next_stamp(&mut self, deadline: HostTime) -> Result<Option<Stamp>, CameraError> {
        let times = self.rig.lock().next_times(deadline.0);
        Ok(times.map(|times| self.stamp(&times)))
    }
}

/// Where the carriage of scope.z truly is now.
pub fn true_z(rig: &Shared) -> Micrometres {
    let rig = rig.lock();
    let now = rig.now();
    rig.truth(0, Axis(2), now)
}
