//! The light that reaches the camera without any object, and what the camera makes of it.

use super::optics::normal_below;
use std::sync::LazyLock;

/// The lamp's light over the picture: 1 in the middle of an even field.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Light {
    /// Share of the light lost in the picture's corners.
    pub vignetting: f64,
    /// Relative rise of the light from the middle to the right and to the bottom edge.
    pub slope: [f64; 2],
}

impl Light {
    /// The light at `x`, `y`, both -1 … 1 from one edge of the picture to the other.
    #[inline]
    pub(super) fn at(&self, x: f64, y: f64) -> f64 {
        1.0 + self.slope[0] * x + self.slope[1] * y - 0.5 * self.vignetting * (x * x + y * y)
    }
}

/// How a frame is exposed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// Grey value in the middle of an empty field, as a share of full scale. 0: the light is off.
    pub level: f64,
    /// Standard deviation of the shot noise in an empty field, as a share of `level`; it goes with the root of the light.
    pub shot_noise: f64,
    /// Standard deviation of the read noise, as a share of full scale.
    pub read_noise: f64,
    /// The noise is a function of this seed and the pixel's place: another frame needs another seed.
    pub seed: u64,
}

impl Exposure {
    /// A mid-grey frame without noise.
    pub const NOISELESS: Self = Self { level: 0.5, shot_noise: 0.0, read_noise: 0.0, seed: 0 };
}

const QUANTILES: usize = 4096;

/// Standard normal values by their rank: a uniform 12-bit number drawn from it is normally distributed.
static NORMAL: LazyLock<[f32; QUANTILES]> = LazyLock::new(|| {
    let mut table = [0.0; QUANTILES];
    let mut x = -4.5_f64;
    for (i, value) in table.iter_mut().enumerate() {
        let share = (i as f64 + 0.5) / QUANTILES as f64;
        // Newton's method from the last quantile, which is always below.
        for _ in 0..30 {
            let density = (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt();
            x += ((share - normal_below(x)) / density).clamp(-0.2, 0.2);
        }
        *value = x as f32;
    }
    table
});

/// Turns light into grey values.
pub(super) struct Sensor {
    full_scale: f64,
    level: f64,
    shot_variance: f64,
    read_variance: f64,
    seed: u64,
}

impl Sensor {
    pub fn new(exposure: &Exposure, bits: u32) -> Self {
        let full_scale = f64::from((1_u32 << bits.clamp(1, 16)) - 1);
        let level = exposure.level.max(0.0) * full_scale;
        Self {
            full_scale,
            level,
            shot_variance: (exposure.shot_noise * level).powi(2),
            read_variance: (exposure.read_noise * full_scale).powi(2),
            seed: exposure.seed,
        }
    }

    /// The grey value of the pixel numbered `index` under `light` (1 in an empty field).
    #[inline]
    pub fn grey(&self, light: f64, index: u64) -> u16 {
        let light = light.max(0.0);
        let variance = self.shot_variance * light + self.read_variance;
        let noise = if variance > 0.0 { variance.sqrt() * f64::from(normal(self.seed, index)) } else { 0.0 };
        // A cast from float to integer saturates; half is added first, for rounding.
        (self.level * light + noise + 0.5).clamp(0.0, self.full_scale) as u16
    }
}

/// A standard normal value of its own for each `seed` and `index` (the splitmix64 finaliser: Steele et al. 2014).
#[inline]
fn normal(seed: u64, index: u64) -> f32 {
    let mut h = seed.wrapping_mul(0xD134_2543_DE82_EF95).wrapping_add(index.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    h = (h ^ (h >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    h = (h ^ (h >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    NORMAL[((h ^ (h >> 31)) >> 52) as usize]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_normal_and_repeats() {
        let n = 200_000_u64;
        let values: Vec<f64> = (0..n).map(|i| f64::from(normal(7, i))).collect();
        let moment = |k: i32| values.iter().map(|v| v.powi(k)).sum::<f64>() / n as f64;
        assert!(moment(1).abs() < 0.01 && (moment(2) - 1.0).abs() < 0.01, "{} {}", moment(1), moment(2));
        assert!(moment(3).abs() < 0.05 && (moment(4) - 3.0).abs() < 0.1, "{} {}", moment(3), moment(4));
        assert_eq!(normal(7, 3), normal(7, 3));
        assert_ne!(normal(7, 3), normal(8, 3));
    }

    #[test]
    fn a_dark_frame_has_only_read_noise() {
        let dark = Exposure { level: 0.0, shot_noise: 0.02, read_noise: 0.0, seed: 1 };
        assert!((0..100).all(|i| Sensor::new(&dark, 16).grey(1.0, i) == 0));
        let lit = Exposure { level: 0.5, ..Exposure::NOISELESS };
        assert_eq!(Sensor::new(&lit, 8).grey(1.0, 0), 128);
        assert_eq!(Sensor::new(&lit, 8).grey(9.0, 0), 255);
    }
}
