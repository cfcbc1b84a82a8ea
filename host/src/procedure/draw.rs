//! Where to look next: uniform in the picture and in depth, seeded, and never all in one plane.

use super::point::Window;
use crate::calibration::chain::Pixel;
use nalgebra::{DMatrix, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Shares of the picture's width and height and of the depth, each 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Share {
    /// From the left to the right edge.
    pub x: f64,
    /// From the top to the bottom edge.
    pub y: f64,
    /// From the lowest to the highest.
    pub depth: f64,
}

impl Share {
    /// The pixel, with a margin to the edges.
    pub fn pixel(self, window: &Window, margin_px: f64) -> Pixel {
        window.at_share(self.x, self.y, margin_px)
    }
}

/// Uniform draws that repeat with their seed.
#[derive(Clone, Debug)]
pub struct Draws {
    random: Pcg64,
}

/// A uniform cube's standard deviation is 0.29 each way; a set this flat determines one direction badly.
const FLATTEST: f64 = 0.12;
/// Sets that are drawn before the flattest is taken as it is: never in practice for 4 and more.
const SETS: usize = 1000;

impl Draws {
    /// Draws of a seed.
    pub fn new(seed: u64) -> Self {
        Self { random: Pcg64::seed_from_u64(seed) }
    }

    /// One place.
    pub fn one(&mut self) -> Share {
        let mut uniform = || self.random.random_range(0.0..=1.0);
        Share { x: uniform(), y: uniform(), depth: uniform() }
    }

    /// `n` places that span the picture both ways (not on a line).
    pub fn in_picture(&mut self, n: usize) -> Vec<Share> {
        self.spread(n, 2)
    }

    /// `n` places that span picture and depth (not in a plane).
    pub fn in_depth(&mut self, n: usize) -> Vec<Share> {
        self.spread(n, 3)
    }

    fn spread(&mut self, n: usize, dimensions: usize) -> Vec<Share> {
        let mut set = Vec::new();
        for _ in 0..SETS {
            set = (0..n).map(|_| self.one()).collect();
            if n <= dimensions || flatness(&set, dimensions) >= FLATTEST {
                break;
            }
        }
        set
    }
}

/// Standard deviation along the direction in which the places differ least.
fn flatness(set: &[Share], dimensions: usize) -> f64 {
    let vectors: Vec<Vector3<f64>> = set.iter().map(|s| Vector3::new(s.x, s.y, s.depth)).collect();
    let mean = vectors.iter().sum::<Vector3<f64>>() / set.len() as f64;
    let centred = DMatrix::from_fn(set.len(), dimensions, |r, c| vectors[r][c] - mean[c]);
    centred.singular_values().min() / (set.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_repeat_are_uniform_and_never_flat() {
        for n in [4, 5, 8, 20] {
            for seed in 0..200 {
                let set = Draws::new(seed).in_depth(n);
                assert_eq!(set, Draws::new(seed).in_depth(n));
                assert!(flatness(&set, 3) >= FLATTEST, "n {n}, seed {seed}");
                assert!(flatness(&Draws::new(seed).in_picture(n.min(5)), 2) >= FLATTEST);
            }
        }
        let mut draws = Draws::new(7);
        let n = 20_000;
        let mean = (0..n).map(|_| draws.one().x).sum::<f64>() / f64::from(n);
        assert!((mean - 0.5).abs() < 4.0 * 0.2887 / f64::from(n).sqrt(), "{mean}");
    }
}
