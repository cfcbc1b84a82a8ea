//! From what the scene reflects to what the sensor delivers: blur, light, tone curve, noise, 8 bits.

use rand::RngExt;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

/// Light that is not the same everywhere: 1 at the picture's centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Change from the left edge to the right one.
    pub across: f32,
    /// Change from the top edge to the bottom one.
    pub down: f32,
    /// How much darker the corners are.
    pub corners: f32,
}

/// What happens between the scene and the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finish {
    /// Standard deviation of the blur, px.
    pub blur_px: f64,
    /// Uneven light.
    pub light: Light,
    /// The file holds light^(1/gamma); 1 for a linear camera.
    pub gamma: f32,
    /// Standard deviation of the noise, in 8-bit levels.
    pub noise: f64,
}

impl Default for Finish {
    /// A linear camera, a little out of focus, in a room with a window.
    fn default() -> Self {
        Self { blur_px: 1.0, light: Light { across: 0.3, down: -0.2, corners: 0.15 }, gamma: 1.0, noise: 2.0 }
    }
}

impl Finish {
    pub(super) fn apply(&self, picture: &mut [f32], w: usize, h: usize, seed: u64) -> Vec<u8> {
        let kernel = kernel(self.blur_px);
        let mut half = vec![0.0; picture.len()];
        blur(picture, &mut half, (w, h), (1, w), &kernel);
        blur(&half, picture, (h, w), (w, 1), &kernel);
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let pixel = |(i, value): (usize, &f32)| {
            let (x, y) = ((i % w) as f32 / w as f32 - 0.5, (i / w) as f32 / h as f32 - 0.5);
            let light = 1.0 + self.light.across * x + self.light.down * y - self.light.corners * 2.0 * (x * x + y * y);
            let level = 255.0 * (value * light).clamp(0.0, 1.0).powf(1.0 / self.gamma);
            (f64::from(level) + self.noise * normal(&mut random)).round().clamp(0.0, 255.0) as u8
        };
        picture.iter().enumerate().map(pixel).collect()
    }
}

/// One standard normal number (Box and Muller 1958).
fn normal(random: &mut Pcg64Mcg) -> f64 {
    let (u, v): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

fn kernel(sigma: f64) -> Vec<f32> {
    let reach = (4.0 * sigma).ceil() as i32;
    let weight = |k: i32| if sigma > 0.0 { (-f64::from(k * k) / (2.0 * sigma * sigma)).exp() } else { 1.0 };
    let sum: f64 = (-reach..=reach).map(weight).sum();
    (-reach..=reach).map(|k| (weight(k) / sum) as f32).collect()
}

/// Blurs each of `lines.1` lines of `lines.0` values; `steps`: to the next value, to the next line.
fn blur(from: &[f32], to: &mut [f32], lines: (usize, usize), steps: (usize, usize), kernel: &[f32]) {
    let reach = kernel.len() / 2;
    for line in 0..lines.1 {
        for i in 0..lines.0 {
            let value = |k: usize| {
                let at = (i + k).saturating_sub(reach).min(lines.0 - 1);
                from[line * steps.1 + at * steps.0]
            };
            to[line * steps.1 + i * steps.0] = kernel.iter().enumerate().map(|(k, weight)| weight * value(k)).sum();
        }
    }
}
