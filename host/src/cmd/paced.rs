//! The simulated rig in real time: it lives as long as somebody looks, and never ahead of this computer's clock.

use super::connection::SIMULATED;
use super::simulated::{Boards, Handle};
use parfocal::frames::camera::{Camera, CameraError, Frame};
use parfocal::frames::stack::Stack;
use parfocal::link::transport::{Transport, real_now};
use parfocal::page::Turret;
use parfocal::picture::Picture;
use parfocal_protocol::units::{Axis, HostTime};
use std::io;
use std::sync::Arc;
use std::time::Duration;

/// How far real and simulated time may part: the boards' shortest reaction to a byte.
const TICK: Duration = Duration::from_micros(300);

/// The simulated rig in real time.
#[derive(Clone)]
pub struct Paced(Handle);

impl Paced {
    /// Takes a rig that has just been switched on.
    pub fn new(rig: Handle) -> Self {
        Self(rig)
    }

    /// Columns and rows of the camera's frames.
    pub fn sensor(&self) -> (u32, u32) {
        let rig = self.0.lock();
        (rig.model().camera.width as u32, rig.model().camera.height as u32)
    }

    /// The objectives in the turret, the default one first: name and depth of field, µm.
    pub fn objectives(&self) -> Vec<(String, f64)> {
        self.0.lock().model().objectives.iter().map(|o| (o.name.into(), o.depth_of_field_um)).collect()
    }

    /// Turns the turret.
    pub fn turret(&self) -> Turret {
        let rig = self.0.clone();
        Box::new(move |name| rig.set_objective(name))
    }

    /// The rig's camera, in real time.
    pub fn camera(&self) -> PacedCamera {
        PacedCamera { rig: self.0.clone(), stack: None }
    }

    /// A camera that shows the plane of a stack at which `scope.z` is.
    pub fn stack_camera(&self, stack: Arc<Stack>) -> PacedCamera {
        let planes = stack.planes.iter().cloned().map(Arc::new).collect();
        PacedCamera { rig: self.0.clone(), stack: Some((stack, planes)) }
    }
}

impl Boards for Paced {
    fn transports(&self) -> Vec<Box<dyn Transport>> {
        let boards = self.0.lock().boards();
        let transport = |board| Box::new(PacedTransport { rig: self.0.clone(), board }) as Box<dyn Transport>;
        (0..boards).map(transport).collect()
    }
}

/// The way to one simulated board, in real time.
struct PacedTransport {
    rig: Handle,
    board: usize,
}

impl Transport for PacedTransport {
    fn name(&self) -> String {
        SIMULATED.into()
    }

    fn read(&mut self, buffer: &mut [u8], deadline: HostTime) -> io::Result<usize> {
        loop {
            let now = real_now();
            {
                let mut rig = self.rig.lock();
                rig.advance(now.0);
                let n = rig.receive(self.board, buffer, 0);
                if n > 0 {
                    return Ok(n);
                }
            }
            if now >= deadline {
                return Ok(0);
            }
            std::thread::sleep(TICK);
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut rig = self.rig.lock();
        rig.advance(real_now().0);
        rig.send(self.board, bytes);
        Ok(())
    }

    fn now(&self) -> HostTime {
        real_now()
    }

    fn reconnect(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The simulated camera, in real time.
pub struct PacedCamera {
    rig: Handle,
    /// A stack, and its planes as frames share them.
    stack: Option<(Arc<Stack>, Vec<Arc<Picture>>)>,
}

impl Camera for PacedCamera {
    fn name(&self) -> String {
        SIMULATED.into()
    }

    fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
        loop {
            let now = real_now();
            let next = {
                let mut rig = self.rig.lock();
                rig.next_shot(now.0).map(|(times, shot)| (times, shot, rig.truth(0, Axis(2), times.middle())))
            };
            if let Some((times, shot, z)) = next {
                // Rendered with the rig free to live on.
                let picture = match &self.stack {
                    Some((stack, planes)) => Ok(planes[stack.nearest(z)].clone()),
                    None => {
                        let frame = shot.render();
                        Picture::grey16(frame.width, frame.height, frame.pixels).map(Arc::new)
                    }
                };
                let picture = picture.map_err(|e| CameraError::Ended { camera: self.name(), reason: e.to_string() })?;
                return Ok(Some(Frame {
                    picture,
                    number: times.number,
                    exposure: Some((HostTime(times.begin), HostTime(times.end))),
                    arrival: real_now(),
                }));
            }
            if now >= deadline {
                return Ok(None);
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
