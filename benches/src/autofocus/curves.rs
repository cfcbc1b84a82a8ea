//! Focus curves of known peak, and the noise of their frames; lengths in µm.

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A file of curves.
#[derive(Debug, Deserialize, Serialize)]
pub struct Curves {
    /// The probe's length that every scan is granted.
    #[serde(rename = "J0")]
    pub j0: f64,
    /// The curves.
    pub curves: Vec<Truth>,
}

/// One curve: Φ(z) = b + (1+u²)^(−p) + Σ h·exp(−(z−c)²/(2s²)), u = (z−zc)/(wl below zc, wr above).
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Truth {
    /// Seeds the noise.
    pub id: u64,
    /// The range is −r to r.
    #[serde(rename = "R")]
    pub r: f64,
    /// Middle of the broad peak.
    pub zc: f64,
    /// Its width below.
    pub wl: f64,
    /// Its width above.
    pub wr: f64,
    /// Its steepness.
    pub p: f64,
    /// Background.
    pub b: f64,
    /// Height, place and width of each bump.
    pub bumps: Vec<[f64; 3]>,
    /// The highest place.
    pub zstar: f64,
    /// A start anywhere in the range.
    pub z0random: f64,
}

impl Curves {
    /// Reads a file.
    ///
    /// # Errors
    /// When it cannot be read or holds something else.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        serde_json::from_str(&text).with_context(|| format!("{} is no file of curves", path.display()))
    }
}

impl Truth {
    /// The value at `z`.
    pub fn phi(&self, z: f64) -> f64 {
        let u = (z - self.zc) / if z < self.zc { self.wl } else { self.wr };
        let bumps: f64 = self.bumps.iter().map(|[h, c, s]| h * (-(z - c) * (z - c) / (2.0 * s * s)).exp()).sum();
        self.b + (1.0 + u * u).powf(-self.p) + bumps
    }

    /// What frame `k` of a run reads at `z`; `noise` is the standard deviation relative to the value.
    pub fn frame(&self, k: u32, z: f64, noise: f64) -> f64 {
        self.phi(z) * (1.0 + if noise > 0.0 { noise * self.deviate(k) } else { 0.0 })
    }

    /// The normal deviate of frame `k`: Box and Muller on the splitmix64 finaliser.
    fn deviate(&self, k: u32) -> f64 {
        let uniform = |j: u64| uniform(self.id.wrapping_mul(0xD134_2543_DE82_EF95), j);
        let k = u64::from(k);
        (-2.0 * uniform(2 * k + 1).ln()).sqrt() * (2.0 * std::f64::consts::PI * uniform(2 * k + 2)).cos()
    }
}

/// Number `j`, between 0 and 1, of a sequence.
pub fn uniform(sequence: u64, j: u64) -> f64 {
    let bits = mix64(sequence.wrapping_add(j.wrapping_mul(0x9E37_79B9_7F4A_7C15)));
    ((bits >> 11) as f64 + 0.5) / (1u64 << 53) as f64
}

/// The splitmix64 finaliser (Steele, Lea, Flood 2014).
pub fn mix64(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_and_curve_are_those_of_the_rules() {
        let curve = Truth {
            id: 100_000,
            r: 100.0,
            zc: 53.326007910351535,
            wl: 26.754956829462195,
            wr: 37.80288990159635,
            p: 0.7324130280092997,
            b: 0.28944002401337177,
            bumps: vec![[0.2906230510705469, 55.21090224628658, 0.5853317761059196]],
            zstar: 55.2060079103519,
            z0random: -86.69408327814494,
        };
        for (k, g) in [-1.04342544, 0.15771813, -1.48204416, 0.40708557].into_iter().enumerate() {
            assert!((curve.deviate(k as u32) - g).abs() < 1e-8);
        }
        assert!((curve.phi(0.0) - 0.5983388).abs() < 1e-7);
    }
}
