//! The chain of transforms at the objective and zoom in use: pixel ↔ ref ↔ manipulator, and the image Jacobian.
//!
//! p_ref = T_mic_ref · T_mic*_mic · T_image_mic* · p_image, and p_ref = T_man_ref · P_R. So
//! T_image_man = T_ref_man · T_mic_ref · T_mic*_mic · T_image_mic* = [[J_n, D_n], [0, 1]].

use super::frames::{Displacement, Image, Man, Mic, MicStar, Point, Ref, Transform};
use crate::rig::{ManipulatorNumber, Rig};
use nalgebra::{Matrix2, Matrix3, Vector3};
use thiserror::Error;

/// A pixel of the full sensor, unbinned: (0, 0) is the centre of the top-left one, x right, y down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pixel {
    /// Columns from the left.
    pub x_px: f64,
    /// Rows from the top.
    pub y_px: f64,
}

/// The full sensor, unbinned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sensor {
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
}

impl Sensor {
    /// P_I = px − ((W−1)/2, (H−1)/2), in the focal plane.
    pub fn to_image(self, pixel: Pixel) -> Point<Image> {
        let (cx, cy) = self.centre();
        Point::new(pixel.x_px - cx, pixel.y_px - cy, 0.0)
    }

    /// Where a point shows; its height above the focal plane does not count.
    pub fn to_pixel(self, p: Point<Image>) -> Pixel {
        let (cx, cy) = self.centre();
        Pixel { x_px: p.coordinates.x + cx, y_px: p.coordinates.y + cy }
    }

    /// Whether a pixel is on the sensor, edges included.
    pub fn holds(self, pixel: Pixel) -> bool {
        let inside = |v: f64, size: u32| (-0.5..=f64::from(size) - 0.5).contains(&v);
        inside(pixel.x_px, self.width_px) && inside(pixel.y_px, self.height_px)
    }

    /// Sensor pixel of a frame's pixel, when the frame shows a crop (left, top, in sensor pixels), binned.
    /// Binned pixels' centres lie between the sensor's.
    pub fn from_frame(x: f64, y: f64, crop: Option<[u32; 4]>, binning: u32) -> Pixel {
        let [left, top, ..] = crop.unwrap_or_default();
        let unbin = |v: f64, start: u32| f64::from(start) + (v + 0.5) * f64::from(binning) - 0.5;
        Pixel { x_px: unbin(x, left), y_px: unbin(y, top) }
    }

    fn centre(self) -> (f64, f64) {
        ((f64::from(self.width_px) - 1.0) / 2.0, (f64::from(self.height_px) - 1.0) / 2.0)
    }
}

/// T_image_mic* of a camera matrix A (µm a pixel).
pub fn camera_transform(a: &Matrix2<f64>) -> Option<Transform<Image, MicStar>> {
    let mut linear = Matrix3::identity();
    linear.fixed_view_mut::<2, 2>(0, 0).copy_from(a);
    Transform::new(linear, Vector3::zeros())
}

/// T_mic*_mic of an objective: diag(α, α, 1) and κ.
pub fn objective_transform(alpha: f64, kappa_um: Vector3<f64>) -> Option<Transform<MicStar, Mic>> {
    Transform::new(Matrix3::from_diagonal(&Vector3::new(alpha, alpha, 1.0)), kappa_um)
}

/// The microscope's part of the chain at one objective and zoom.
#[derive(Clone, Copy, Debug)]
pub struct Chain {
    sensor: Sensor,
    mic_from_image: Transform<Image, Mic>,
}

/// Why there is no chain.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ChainError {
    /// Nobody said which objective is in the light path.
    #[error(
        "the objective in use is not known, and a wrong one breaks pipettes: say it with 'parfocal objective NAME'"
    )]
    NoObjective,
    /// That objective is not calibrated at that zoom.
    #[error("objective '{objective}' is not calibrated at zoom {zoom}: run 'parfocal calibrate objective' with it")]
    Objective {
        /// Its name.
        objective: String,
        /// The zoom in use.
        zoom: String,
    },
    /// No camera matrix.
    #[error("the camera is not calibrated: run 'parfocal calibrate camera'")]
    NoCamera,
    /// The manipulator has no registration.
    #[error("manipulator {0} is not registered: run 'parfocal calibrate registration --manipulator {0}'")]
    NotRegistered(ManipulatorNumber),
    /// The manipulator's pipette direction is not known.
    #[error("the pipette's direction on {0} is not known: run 'parfocal calibrate pipette --manipulator {0}'")]
    NoPipette(ManipulatorNumber),
}

impl Chain {
    /// The chain of a camera matrix and an objective; `None` when either cannot be inverted.
    pub fn new(sensor: Sensor, a: &Matrix2<f64>, alpha: f64, kappa_um: Vector3<f64>) -> Option<Self> {
        Some(Self { sensor, mic_from_image: objective_transform(alpha, kappa_um)? * camera_transform(a)? })
    }

    /// The chain at the rig's objective and zoom in use.
    ///
    /// # Errors
    /// [`ChainError`], saying what to calibrate.
    pub fn of(rig: &Rig) -> Result<Self, ChainError> {
        let contents = rig.contents();
        let name = contents.objective_in_use.as_ref().ok_or(ChainError::NoObjective)?;
        let zoom = contents.zoom_in_use.unwrap_or(1.0);
        let missing = || ChainError::Objective { objective: name.clone(), zoom: zoom.to_string() };
        let objective = contents.objectives.get(name).ok_or_else(missing)?;
        let (alpha, mut kappa) = match objective.zooms.iter().find(|z| z.zoom == zoom) {
            Some(entry) => (entry.alpha, Vector3::from(entry.kappa_um)),
            None if objective.default && zoom == 1.0 => (1.0, Vector3::zeros()),
            None => return Err(missing()),
        };
        kappa.z += contents.objective_height_um;
        let camera = contents.camera.as_ref().ok_or(ChainError::NoCamera)?;
        let [[a, b], [c, d]] = camera.calibration.as_ref().ok_or(ChainError::NoCamera)?.matrix_um_per_px;
        let sensor = Sensor { width_px: camera.width_px, height_px: camera.height_px };
        Self::new(sensor, &Matrix2::new(a, b, c, d), alpha, kappa).ok_or(ChainError::NoCamera)
    }

    /// The sensor.
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// T_image_ref with the microscope at `position` (P_M, µm).
    pub fn ref_from_image(&self, position: Vector3<f64>) -> Transform<Image, Ref> {
        Transform::<Mic, Ref>::translation(position) * self.mic_from_image
    }

    /// The place in focus at a pixel.
    pub fn pixel_to_ref(&self, position: Vector3<f64>, pixel: Pixel) -> Point<Ref> {
        self.ref_from_image(position) * self.sensor.to_image(pixel)
    }

    /// Where a place shows, and how far above the focal plane it is, µm.
    pub fn ref_to_pixel(&self, position: Vector3<f64>, p: Point<Ref>) -> (Pixel, f64) {
        let p = self.ref_from_image(position).inverse() * p;
        (self.sensor.to_pixel(p), p.coordinates.z)
    }

    /// Where the microscope has to be for a place to show in focus at a pixel: P_M, µm.
    pub fn position_showing(&self, p: Point<Ref>, pixel: Pixel) -> Vector3<f64> {
        p.coordinates - (self.mic_from_image * self.sensor.to_image(pixel)).coordinates
    }
}

/// A registered manipulator in the chain.
#[derive(Clone, Copy, Debug)]
pub struct Arm {
    ref_from_man: Transform<Man, Ref>,
    /// The pipette's direction of advance in ref, a unit vector.
    direction: Option<Displacement<Ref>>,
}

impl Arm {
    /// An arm with its registration, its tip's offset since (in ref, µm), and the pipette's direction if known.
    pub fn new(
        ref_from_man: Transform<Man, Ref>,
        tip_offset: Displacement<Ref>,
        direction: Option<Displacement<Ref>>,
    ) -> Self {
        Self { ref_from_man: Transform::<Ref, Ref>::translation(tip_offset.coordinates) * ref_from_man, direction }
    }

    /// A manipulator as the rig has it: registration, newest tip offset, pipette.
    ///
    /// # Errors
    /// [`ChainError::NotRegistered`].
    pub fn of(rig: &Rig, number: ManipulatorNumber) -> Result<Self, ChainError> {
        let missing = ChainError::NotRegistered(number);
        let manipulator = rig.contents().manipulators.get(&number).ok_or(missing.clone())?;
        let registration = manipulator.registration.as_ref().ok_or(missing.clone())?;
        let ref_from_man = Transform::from_rows(&registration.matrix).ok_or(missing)?;
        let offset = manipulator.tip_offsets.last().map_or([0.0; 3], |tip| tip.offset_um);
        let direction =
            manipulator.pipette.as_ref().map(|p| direction(p.descent_deg.to_radians(), p.azimuth_deg.to_radians()));
        Ok(Self::new(ref_from_man, Vector3::from(offset).into(), direction))
    }

    /// A manipulator as its marker shows it: coarse registration, pipette, and the tip's standard deviation, µm. `None` without one.
    pub fn coarse_of(rig: &Rig, number: ManipulatorNumber) -> Option<(Self, f64)> {
        let manipulator = rig.contents().manipulators.get(&number)?;
        let coarse = manipulator.coarse.as_ref()?;
        let ref_from_man = Transform::from_rows(&coarse.matrix)?;
        let pipette = manipulator.pipette.as_ref();
        let direction = pipette.map(|p| direction(p.descent_deg.to_radians(), p.azimuth_deg.to_radians()));
        Some((Self { ref_from_man, direction }, coarse.error_um))
    }

    /// The pipette's direction of advance in ref, if known: a unit vector.
    pub fn direction(&self) -> Option<Displacement<Ref>> {
        self.direction
    }

    /// The arm with its tip elsewhere in ref.
    #[must_use]
    pub fn shifted(&self, by: Displacement<Ref>) -> Self {
        Self::new(self.ref_from_man, by, self.direction)
    }

    /// T_man_ref with the tip's offset.
    pub fn ref_from_man(&self) -> Transform<Man, Ref> {
        self.ref_from_man
    }

    /// Where the tip is at a joint position.
    pub fn tip(&self, joints: Point<Man>) -> Point<Ref> {
        self.ref_from_man * joints
    }

    /// The joint position that brings the tip to a place.
    pub fn joints_for(&self, tip: Point<Ref>) -> Point<Man> {
        self.ref_from_man.inverse() * tip
    }

    /// T_image_man at a microscope position; its linear part is J_n.
    pub fn man_from_image(&self, chain: &Chain, position: Vector3<f64>) -> Transform<Image, Man> {
        self.ref_from_man.inverse() * chain.ref_from_image(position)
    }

    /// J_n: a displacement, or velocity, in the picture (px, px, µm of focus) as one of the joints (µm).
    pub fn jacobian(&self, chain: &Chain) -> Matrix3<f64> {
        *self.man_from_image(chain, Vector3::zeros()).linear()
    }

    /// The joints' velocity (µm/s) that moves the tip at a velocity in the picture (px/s, px/s, µm/s).
    pub fn jog(&self, chain: &Chain, in_picture: Displacement<Image>) -> Displacement<Man> {
        self.man_from_image(chain, Vector3::zeros()) * in_picture
    }

    /// The joint move that advances the tip by `distance_um` along the pipette (negative: withdraws): D·L⁻¹u.
    /// `None` when the pipette's direction is not known.
    pub fn coaxial(&self, distance_um: f64) -> Option<Displacement<Man>> {
        let direction = self.direction?;
        Some(self.ref_from_man.inverse() * (distance_um * direction))
    }
}

/// A pipette's direction of advance in ref, z up: u = (cosΘ cosψ, cosΘ sinψ, −sinΘ).
pub fn direction(descent_rad: f64, azimuth_rad: f64) -> Displacement<Ref> {
    let (down, across) = descent_rad.sin_cos();
    Displacement::new(across * azimuth_rad.cos(), across * azimuth_rad.sin(), -down)
}

/// Descent Θ and azimuth ψ (rad) of a direction of advance.
pub fn angles(u: Displacement<Ref>) -> (f64, f64) {
    let u = u.coordinates;
    ((-u.z).atan2(u.x.hypot(u.y)), u.y.atan2(u.x))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chain() -> Chain {
        let sensor = Sensor { width_px: 1920, height_px: 1200 };
        Chain::new(sensor, &Matrix2::new(0.32, 0.02, 0.03, -0.31), 0.4, Vector3::new(10.0, -20.0, 30.0)).unwrap()
    }

    fn arm() -> Arm {
        let linear = Matrix3::new(1.0, 0.1, 0.5, 0.0, 0.98, 0.0, 0.02, 0.0, 0.87);
        let map = Transform::new(linear, Vector3::new(100.0, 200.0, 300.0)).unwrap();
        Arm::new(map, Displacement::new(1.0, 2.0, 3.0), Some(direction(30f64.to_radians(), 1.0)))
    }

    #[test]
    fn a_pixel_goes_to_ref_by_the_formula_and_back() {
        let (chain, at, px) = (chain(), Vector3::new(5.0, 6.0, 7.0), Pixel { x_px: 100.0, y_px: 300.0 });
        let (x, y) = (100.0 - 959.5, 300.0 - 599.5);
        let p = chain.pixel_to_ref(at, px).coordinates;
        assert!((p.x - (5.0 + 10.0 + 0.4 * (0.32 * x + 0.02 * y))).abs() < 1e-9);
        assert!((p.y - (6.0 - 20.0 + 0.4 * (0.03 * x - 0.31 * y))).abs() < 1e-9);
        assert!((p.z - 37.0).abs() < 1e-9);
        let (back, height) = chain.ref_to_pixel(at, p.into());
        assert!((back.x_px - 100.0).abs() < 1e-9 && (back.y_px - 300.0).abs() < 1e-9 && height.abs() < 1e-9);
        assert!((chain.position_showing(p.into(), px) - at).norm() < 1e-9);
    }

    #[test]
    fn a_jog_moves_the_tip_in_the_picture_as_asked() {
        let (chain, arm, at) = (chain(), arm(), Vector3::new(5.0, 6.0, 7.0));
        let joints = Point::new(50.0, 60.0, 70.0);
        let (before, height) = chain.ref_to_pixel(at, arm.tip(joints));
        let moved = joints + arm.jog(&chain, Displacement::new(12.0, -7.0, 2.0));
        let (after, above) = chain.ref_to_pixel(at, arm.tip(moved));
        assert!((after.x_px - before.x_px - 12.0).abs() < 1e-9 && (after.y_px - before.y_px + 7.0).abs() < 1e-9);
        assert!((above - height - 2.0).abs() < 1e-9);
        assert!((arm.joints_for(arm.tip(joints)) - joints).coordinates.norm() < 1e-9);
    }

    #[test]
    fn a_coaxial_advance_moves_the_tip_along_the_pipette() {
        let arm = arm();
        let from = Point::new(1.0, 2.0, 3.0);
        let moved = arm.tip(from + arm.coaxial(100.0).unwrap()) - arm.tip(from);
        let (descent, azimuth) = angles(moved);
        assert!((moved.coordinates.norm() - 100.0).abs() < 1e-9 && moved.coordinates.z < 0.0);
        assert!((descent.to_degrees() - 30.0).abs() < 1e-9 && (azimuth - 1.0).abs() < 1e-9);
    }

    #[test]
    fn binned_crops_are_read_in_sensor_pixels() {
        assert_eq!(Sensor::from_frame(0.0, 0.0, None, 1), Pixel { x_px: 0.0, y_px: 0.0 });
        // Two by two: the first binned pixel's centre lies between sensor pixels 10 and 11.
        assert_eq!(Sensor::from_frame(0.0, 3.0, Some([10, 20, 100, 100]), 2), Pixel { x_px: 10.5, y_px: 26.5 });
    }
}
