//! A stereo camera looking at printed markers: pictures with lens distortion, blur, uneven light, occluders, tone curve
//! and noise, the same ones for the same seed.
//!
//! The renderer casts rays through each sub-pixel of a marker's surroundings; it shares no code with the registration that
//! reads its pictures, not even the way that lens distortion is undone. Lengths are mm. A pixel's centre has whole coordinates.

pub mod bench;
mod finish;
mod lens;

pub use finish::{Finish, Light};
pub use lens::Lens;

/// A rigid map: `p ↦ rotation·p + translation`, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Row by row.
    pub rotation: [[f64; 3]; 3],
    /// mm.
    pub translation: [f64; 3],
}

impl Pose {
    /// Maps a point.
    pub fn map(&self, p: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| {
            self.translation[i] + self.rotation[i][0] * p[0] + self.rotation[i][1] * p[1] + self.rotation[i][2] * p[2]
        })
    }

    /// The map that undoes this one.
    pub fn inverse(&self) -> Self {
        let rotation: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| self.rotation[j][i]));
        let back = Self { rotation, translation: [0.0; 3] }.map(self.translation);
        Self { rotation, translation: back.map(|v| -v) }
    }

    /// `self` after `first`.
    pub fn after(&self, first: &Self) -> Self {
        let rotation = std::array::from_fn(|i| {
            std::array::from_fn(|j| (0..3).map(|k| self.rotation[i][k] * first.rotation[k][j]).sum())
        });
        Self { rotation, translation: self.map(first.translation) }
    }
}

/// A flat square print: `cells` x `cells` squares, the outer ring of them the white margin.
#[derive(Clone, Debug)]
pub struct Print {
    /// Row by row from the top left; true is white paper.
    pub white: Vec<bool>,
    /// Squares along a side, the margin included.
    pub cells: usize,
    /// Side of one square, mm.
    pub cell_mm: f64,
    /// Print to world: origin at the print's centre, x right, y down, z into the paper.
    pub pose: Pose,
}

/// Something dark between camera and markers: a disc facing the camera, in the world.
#[derive(Clone, Copy, Debug)]
pub struct Occluder {
    /// Centre in the world, mm.
    pub centre: [f64; 3],
    /// mm.
    pub radius_mm: f64,
    /// What it reflects, 0 to 1.
    pub reflectance: f64,
}

/// What there is to see.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// The markers.
    pub prints: Vec<Print>,
    /// What hides parts of them.
    pub occluders: Vec<Occluder>,
}

/// A camera somewhere.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    /// Its lens.
    pub lens: Lens,
    /// World to camera: x right, y down, z forward.
    pub pose: Pose,
    /// Columns and rows of its pictures.
    pub size: (usize, usize),
}

/// Sub-pixels along a pixel's side.
const FINE: usize = 4;
/// What white paper, black ink and the background reflect.
const WHITE: f32 = 0.85;
const BLACK: f32 = 0.06;
const BACKGROUND: f32 = 0.35;

/// Takes an 8-bit grey picture, row by row. The same scene, camera, finish and seed give the same bytes.
pub fn render(scene: &Scene, camera: &Camera, finish: &Finish, seed: u64) -> Vec<u8> {
    let (w, h) = camera.size;
    let mut sum = vec![BACKGROUND; w * h];
    let prints: Vec<Seen<'_>> = scene.prints.iter().filter_map(|p| Seen::new(p, camera)).collect();
    let discs: Vec<([f64; 3], &Occluder)> =
        scene.occluders.iter().map(|o| (camera.pose.map(o.centre), o)).filter(|(c, _)| c[2] > 1.0).collect();
    let mut touched = vec![false; w * h];
    for area in prints.iter().map(|s| s.area).chain(discs.iter().map(|(c, o)| disc_area(*c, o.radius_mm, camera))) {
        for y in area[1]..area[3] {
            touched[y * w + area[0]..y * w + area[2].max(area[0])].fill(true);
        }
    }
    for (i, value) in sum.iter_mut().enumerate().filter(|(i, _)| touched[*i]) {
        let (x, y) = (i % w, i / w);
        let here: Vec<&Seen<'_>> = prints.iter().filter(|s| s.covers(x, y)).collect();
        // Within a pixel a lens bends rays by less than 1e-4 px more than this.
        let ray = |dx: f64, dy: f64| camera.lens.ray([x as f64 + dx, y as f64 + dy]);
        let (middle, right, below) = (ray(0.0, 0.0), ray(0.5, 0.0), ray(0.0, 0.5));
        let mut light = 0.0;
        for sub in 0..FINE * FINE {
            let offset = |k: usize| 2.0 * ((k as f64 + 0.5) / FINE as f64 - 0.5);
            let (u, v) = (offset(sub % FINE), offset(sub / FINE));
            let along = |k: usize| middle[k] + u * (right[k] - middle[k]) + v * (below[k] - middle[k]);
            light += reflectance([along(0), along(1)], &here, &discs);
        }
        *value = light / (FINE * FINE) as f32;
    }
    finish.apply(&mut sum, w, h, seed)
}

/// What a ray from the camera's centre along (x, y, 1) meets first.
fn reflectance(ray: [f64; 2], prints: &[&Seen<'_>], discs: &[([f64; 3], &Occluder)]) -> f32 {
    let mut nearest = f64::INFINITY;
    let mut value = BACKGROUND;
    for print in prints {
        if let Some((z, white)) = print.hit(ray)
            && z < nearest
        {
            (nearest, value) = (z, if white { WHITE } else { BLACK });
        }
    }
    for (c, disc) in discs {
        let away = ((ray[0] * c[2] - c[0]).powi(2) + (ray[1] * c[2] - c[1]).powi(2)).sqrt();
        if away < disc.radius_mm && c[2] < nearest {
            (nearest, value) = (c[2], disc.reflectance as f32);
        }
    }
    value
}

/// Left, top, right and bottom (excluded) of the pixels that the points may touch.
fn area_of(points: &[[f64; 3]], camera: &Camera) -> [usize; 4] {
    let (w, h) = camera.size;
    let px: Vec<[f64; 2]> = points.iter().map(|p| camera.lens.pixel([p[0] / p[2], p[1] / p[2]])).collect();
    let low = |k: usize| px.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min) - 6.0;
    let high = |k: usize| px.iter().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max) + 6.0;
    let clip = |v: f64, most: usize| v.clamp(0.0, most as f64) as usize;
    [clip(low(0), w), clip(low(1), h), clip(high(0), w), clip(high(1), h)]
}

fn disc_area(c: [f64; 3], r: f64, camera: &Camera) -> [usize; 4] {
    area_of(&[[-r, -r], [r, -r], [r, r], [-r, r]].map(|d| [c[0] + d[0], c[1] + d[1], c[2]]), camera)
}

/// A print that faces the camera.
struct Seen<'a> {
    print: &'a Print,
    to_print: Pose,
    area: [usize; 4],
}

impl<'a> Seen<'a> {
    fn new(print: &'a Print, camera: &Camera) -> Option<Self> {
        let to_camera = camera.pose.after(&print.pose);
        let half = print.cells as f64 * print.cell_mm / 2.0;
        let corners =
            [[-half, -half], [half, -half], [half, half], [-half, half]].map(|c| to_camera.map([c[0], c[1], 0.0]));
        let normal = [0, 1, 2].map(|i| to_camera.rotation[i][2]);
        let towards: f64 = (0..3).map(|i| normal[i] * to_camera.translation[i]).sum();
        // z points into the paper: the printed side is seen when z points away from the camera.
        (towards > 0.0 && corners.iter().all(|c| c[2] > 1.0)).then(|| Self {
            print,
            to_print: to_camera.inverse(),
            area: area_of(&corners, camera),
        })
    }

    /// Whether the print may touch this pixel.
    fn covers(&self, x: usize, y: usize) -> bool {
        let [left, top, right, bottom] = self.area;
        (left..right).contains(&x) && (top..bottom).contains(&y)
    }

    /// Depth and colour of the print where the ray meets it.
    fn hit(&self, ray: [f64; 2]) -> Option<(f64, bool)> {
        let origin = self.to_print.translation;
        let far = self.to_print.map([ray[0], ray[1], 1.0]);
        let z = -origin[2] / (far[2] - origin[2]);
        let cell = |k: usize| {
            let at = origin[k] + z * (far[k] - origin[k]);
            (at / self.print.cell_mm + self.print.cells as f64 / 2.0).floor()
        };
        let (column, row, cells) = (cell(0), cell(1), self.print.cells as f64);
        (z > 0.0 && column >= 0.0 && row >= 0.0 && column < cells && row < cells)
            .then(|| (z, self.print.white[row as usize * self.print.cells + column as usize]))
    }
}
