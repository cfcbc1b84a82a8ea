//! Draws what a camera sees through the objective: micropipettes, cells and debris at their own heights, blurred by their
//! distance from the focal plane, under uneven light, with noise.
//!
//! A frame is a pure function of the scene, the viewpoint and the exposure. It costs little where there is nothing to see: a
//! 640x480 frame with one pipette takes a few milliseconds, a region of it in proportion less.
//!
//! ```
//! use parfocal_simulator::scene::{Exposure, Pipette, Scene, Viewpoint};
//!
//! let pipette = Pipette {
//!     tip_um: [0.0, 0.0, 5.0],
//!     azimuth_rad: 0.0,
//!     descent_rad: 0.5,
//!     opening_radius_um: 1.0,
//!     half_angle_rad: 0.15,
//!     contrast: 0.1,
//! };
//! let scene = Scene { pipettes: vec![pipette], ..Scene::default() };
//! let view = Viewpoint::level([0.0, 0.0], 5.0, 0.32, 640, 480);
//! let frame = scene.render(&view, &Exposure::NOISELESS);
//! assert_eq!(frame.pixels.len(), 640 * 480);
//! ```

mod light;
mod optics;
mod paint;
mod pipette;
mod random;
mod speck;

pub use light::{Exposure, Light};
pub use optics::{Kernel, Optics};
pub use pipette::Pipette;
pub use random::{Drawn, Ranges, Seen, Show};
pub use speck::{Matter, Speck};

/// What lies under the microscope, in ref (µm, z up), and the lamp that lights it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// The micropipettes.
    pub pipettes: Vec<Pipette>,
    /// Cells and debris.
    pub specks: Vec<Speck>,
    /// The lamp's light, which stays with the picture.
    pub light: Light,
}

/// Where the microscope looks, and through what.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    /// The optical axis in ref (µm): what the middle of the picture, px ((width - 1)/2, (height - 1)/2), shows.
    pub centre_um: [f64; 2],
    /// Height of the focal plane in ref, µm.
    pub focus_um: f64,
    /// From pixels (x right, y down) to ref: `ref = centre + matrix · (px - middle)`.
    pub matrix_um_per_px: [[f64; 2]; 2],
    /// Columns of the whole picture.
    pub width: usize,
    /// Rows of the whole picture.
    pub height: usize,
    /// Bits of a grey value, 1 to 16.
    pub bits: u32,
    /// The objective.
    pub optics: Optics,
}

impl Viewpoint {
    /// A 16-bit camera with square pixels, its columns along ref's x axis, its rows against the y axis (as seen from above),
    /// behind a 40x/0.8 W objective.
    pub fn level(centre_um: [f64; 2], focus_um: f64, pixel_um: f64, width: usize, height: usize) -> Self {
        let matrix_um_per_px = [[pixel_um, 0.0], [0.0, -pixel_um]];
        Self { centre_um, focus_um, matrix_um_per_px, width, height, bits: 16, optics: Optics::WATER_40X }
    }

    /// The point of ref that a place in the picture shows, µm.
    #[inline]
    pub fn ref_um(&self, x_px: f64, y_px: f64) -> [f64; 2] {
        let [[a, b], [c, d]] = self.matrix_um_per_px;
        let (x, y) = (x_px - 0.5 * (self.width as f64 - 1.0), y_px - 0.5 * (self.height as f64 - 1.0));
        [self.centre_um[0] + a * x + b * y, self.centre_um[1] + c * x + d * y]
    }

    /// Where in the picture a point of ref is seen, px. `None` if the matrix is singular.
    pub fn picture_px(&self, [x_um, y_um]: [f64; 2]) -> Option<[f64; 2]> {
        let [[a, b], [c, d]] = self.matrix_um_per_px;
        let determinant = a * d - b * c;
        let (x, y) = (x_um - self.centre_um[0], y_um - self.centre_um[1]);
        let px = [(d * x - b * y) / determinant, (a * y - c * x) / determinant];
        let middle = [0.5 * (self.width as f64 - 1.0), 0.5 * (self.height as f64 - 1.0)];
        px.iter().all(|v| v.is_finite()).then(|| [middle[0] + px[0], middle[1] + px[1]])
    }

    /// The longer side of a pixel, µm.
    pub fn pitch_um(&self) -> f64 {
        let [[a, b], [c, d]] = self.matrix_um_per_px;
        a.hypot(c).max(b.hypot(d))
    }
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// A grey picture, row after row. Its values fill the viewpoint's bits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width · height` values.
    pub pixels: Vec<u16>,
}

impl Scene {
    /// The whole picture.
    pub fn render(&self, view: &Viewpoint, exposure: &Exposure) -> Frame {
        self.render_region(view, exposure, Region { x: 0, y: 0, width: view.width, height: view.height })
    }

    /// A part of the picture, with the same values as in the whole. What of `region` lies outside the picture is left away.
    pub fn render_region(&self, view: &Viewpoint, exposure: &Exposure, region: Region) -> Frame {
        let (x, y) = (region.x.min(view.width), region.y.min(view.height));
        let region =
            Region { x, y, width: region.width.min(view.width - x), height: region.height.min(view.height - y) };
        let mut contrast = vec![0.0_f32; region.width * region.height];
        for speck in &self.specks {
            paint::add(&speck::Projection::new(speck, view), view, region, &mut contrast);
        }
        for pipette in &self.pipettes {
            paint::add(&pipette::Projection::new(pipette, view), view, region, &mut contrast);
        }
        let sensor = light::Sensor::new(exposure, view.bits);
        // -1 … 1 from edge to edge of the whole picture.
        let place = |i: usize, n: usize| if n > 1 { 2.0 * i as f64 / (n as f64 - 1.0) - 1.0 } else { 0.0 };
        let mut pixels = Vec::with_capacity(contrast.len());
        for (row, y) in contrast.chunks(region.width.max(1)).zip(region.y..) {
            let v = place(y, view.height);
            let first = y * view.width + region.x;
            pixels.extend(row.iter().enumerate().map(|(i, contrast)| {
                let light = self.light.at(place(region.x + i, view.width), v) * (1.0 + f64::from(*contrast));
                sensor.grey(light, (first + i) as u64)
            }));
        }
        Frame { width: region.width, height: region.height, pixels }
    }
}

#[cfg(test)]
mod tests;
