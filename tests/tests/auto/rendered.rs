//! The simulated microscope's camera, pictures and all.

use crate::world::World;
use parfocal::frames::camera::{Camera, CameraError, Frame};
use parfocal::picture::{Picture, Roi};
use parfocal_protocol::units::HostTime;
use parfocal_simulator::scene::Region;

/// The simulated microscope's camera, pictures and all.
pub struct Rendered(pub World);

impl Camera for Rendered {
    fn name(&self) -> String {
        "rendered".into()
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
        let region = |p: Roi| Region { x: p.x, y: p.y, width: p.width, height: p.height };
        let drawn = part.and_then(|part| shot.render_part(region(part)));
        let left = if drawn.is_some() { None } else { part };
        let drawn = drawn.unwrap_or_else(|| shot.render());
        let frame = Frame {
            picture: Picture::grey16(drawn.width, drawn.height, drawn.pixels).unwrap().into(),
            number: times.number,
            exposure: Some((HostTime(times.begin), HostTime(times.end))),
            arrival: HostTime(times.arrival),
        };
        Ok(Some((frame, left)))
    }
}
