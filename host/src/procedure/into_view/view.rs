//! What an objective shows.

use crate::calibration::chain::{Chain, ChainError, Pixel};
use crate::calibration::frames::{Displacement, Point, Ref};
use crate::procedure::point::Window;
use crate::rig::Rig;
use nalgebra::{Vector2, Vector3};

/// Depth of field when the rig's file does not say, µm.
const DEPTH_UM: f64 = 1.0;

/// An objective's view.
#[derive(Clone, Copy)]
pub(super) struct View {
    pub chain: Chain,
    pub middle: Pixel,
    window: Window,
    /// The picture's shorter side, in µm and in the sensor's pixels, and the depth of field, µm.
    pub side_um: f64,
    pub side_px: f64,
    pub depth_um: f64,
}

impl View {
    pub fn of(rig: &Rig, window: Window, name: &str) -> Result<Self, ChainError> {
        let mut rig = rig.clone();
        rig.contents_mut().objective_in_use = Some(name.into());
        let chain = Chain::of(&rig)?;
        let side_px = window.side_px();
        let unit = chain.ref_from_image(Vector3::zeros()).linear().column(0).norm();
        let depth_um = rig.contents().objectives.get(name).and_then(|o| o.depth_of_field_um).unwrap_or(DEPTH_UM);
        let sensor = chain.sensor();
        let middle =
            Pixel { x_px: (f64::from(sensor.width_px) - 1.0) / 2.0, y_px: (f64::from(sensor.height_px) - 1.0) / 2.0 };
        Ok(Self { chain, middle, window, side_um: side_px * unit, side_px, depth_um })
    }

    /// Where frames show a place, the microscope at a position.
    pub fn frame_px(&self, position: Vector3<f64>, p: Point<Ref>) -> Vector2<f64> {
        let at = self.window.to_frame(self.chain.ref_to_pixel(position, p).0);
        Vector2::new(at.x_px, at.y_px)
    }

    /// The way that a direction there has in frames, px.
    pub fn towards(&self, position: Vector3<f64>, p: Point<Ref>, direction: Displacement<Ref>) -> Vector2<f64> {
        let along = direction.coordinates.xy() * (self.side_um / 10.0);
        self.frame_px(position, p + Displacement::new(along.x, along.y, 0.0)) - self.frame_px(position, p)
    }
}
