//! The real picture turned, mirrored, enlarged and pasted on other backgrounds.

use parfocal::picture::Picture;

/// How a picture is shown.
#[derive(Clone, Copy, Debug)]
pub struct Pasted {
    pub turn_deg: f64,
    pub mirrored: bool,
    pub scale: f64,
    pub background: Background,
    pub seed: u64,
}

/// What it is shown on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Background {
    /// Even light, a camera's noise.
    Even,
    /// The light rises to one side and falls to the corners.
    Uneven,
    /// As `Uneven`, with blurred cells beside the pipette.
    Cells,
}

/// Columns and rows of what comes out.
const WIDTH: usize = 480;
const HEIGHT: usize = 400;

/// The grey value of no object in the stack, and the noise added.
const EMPTY: f64 = 30_000.0;
const NOISE: f64 = 150.0;

/// Pixels over which the pasted picture's edge fades out.
const FADE_PX: f64 = 6.0;

/// Numbers that look random (Knuth's MMIX generator).
struct Random(u64);

impl Random {
    fn even(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Nearly normal, with a standard deviation of 1.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.even()).sum::<f64>() - 6.0
    }
}

impl Pasted {
    fn middle(&self) -> [f64; 2] {
        let mut random = Random(self.seed);
        let mut off = |n: usize, most: f64| 0.5 * n as f64 + most * (2.0 * random.even() - 1.0);
        [off(WIDTH, 25.0), off(HEIGHT, 20.0)]
    }

    /// Where a place of the picture is shown.
    pub fn shown(&self, picture: &Picture, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.turn_deg.to_radians().sin_cos();
        let (x, y) = (x - 0.5 * (picture.width as f64 - 1.0), y - 0.5 * (picture.height as f64 - 1.0));
        let x = if self.mirrored { -x } else { x };
        let [cx, cy] = self.middle();
        [cx + self.scale * (cos * x - sin * y), cy + self.scale * (sin * x + cos * y)]
    }

    /// The place of the picture that is shown at a pixel.
    fn place(&self, picture: &Picture, x: f64, y: f64) -> [f64; 2] {
        let (sin, cos) = self.turn_deg.to_radians().sin_cos();
        let [cx, cy] = self.middle();
        let (x, y) = ((x - cx) / self.scale, (y - cy) / self.scale);
        let (u, v) = (cos * x + sin * y, cos * y - sin * x);
        let u = if self.mirrored { -u } else { u };
        [u + 0.5 * (picture.width as f64 - 1.0), v + 0.5 * (picture.height as f64 - 1.0)]
    }

    /// The picture as it is shown.
    pub fn picture(&self, picture: &Picture) -> Picture {
        let mut random = Random(self.seed ^ 0x5EED);
        let [tip_x, tip_y] = self.shown(picture, [28.0, 15.0]);
        let cells: Vec<[f64; 4]> = (0..14)
            .map(|_| {
                let place = [WIDTH, HEIGHT].map(|n| random.even() * n as f64);
                [place[0], place[1], 8.0 + 18.0 * random.even(), 1200.0 * (random.even() - 0.6)]
            })
            .filter(|[x, y, ..]| self.background == Background::Cells && (x - tip_x).hypot(y - tip_y) > 120.0)
            .collect();
        let grey = (0..WIDTH * HEIGHT).map(|i| {
            let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
            let [u, v] = self.place(picture, x, y);
            let (right, bottom) = (picture.width as f64 - 1.0, picture.height as f64 - 1.0);
            let inside = (u.min(right - u)).min(v.min(bottom - v));
            let mut value = EMPTY;
            if inside > 0.0 {
                value += (inside / FADE_PX).min(1.0) * (between(picture, u, v) - EMPTY);
            }
            if self.background != Background::Even {
                let (a, b) = (x / WIDTH as f64 - 0.5, y / HEIGHT as f64 - 0.5);
                value += 2000.0 * a + 800.0 * b - 3000.0 * (a * a + b * b);
            }
            for [cx, cy, radius, strength] in &cells {
                value += strength * (-0.5 * ((x - cx).powi(2) + (y - cy).powi(2)) / (radius * radius)).exp();
            }
            (value + NOISE * random.normal()).round().clamp(0.0, 65_535.0) as u16
        });
        Picture::grey16(WIDTH, HEIGHT, grey.collect()).unwrap()
    }
}

/// The grey value between the pixels about a place.
fn between(picture: &Picture, x: f64, y: f64) -> f64 {
    let (i, j) = ((x as usize).min(picture.width - 2), (y as usize).min(picture.height - 2));
    let (u, v) = (x - i as f64, y - j as f64);
    let grey = |i: usize, j: usize| f64::from(picture.view().get(i, j).unwrap());
    let row = |j: usize| grey(i, j) + u * (grey(i + 1, j) - grey(i, j));
    row(j) + v * (row(j + 1) - row(j))
}
