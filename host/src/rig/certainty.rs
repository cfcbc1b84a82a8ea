//! How well a calibrated map is known, so that a move by it can tell its expected error.

use serde::{Deserialize, Serialize};

/// How well an affine map (or a stiffer one) is known. What it says of x has the standard error
/// `noise_um · √(1/samples + (x − at)ᵀ · spread · (x − at))` in each coordinate: least where the samples were, growing away from there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certainty {
    /// Standard deviation of a sample's noise in one coordinate.
    pub noise_um: f64,
    /// Degrees of freedom that it was estimated with.
    pub freedom: usize,
    /// Samples used.
    pub samples: usize,
    /// Standard error of each element of the matrix, one number a column, in the matrix' unit.
    pub standard_errors: Vec<f64>,
    /// Mean of the samples' sources: joints for a registration, px from the picture's middle for a camera.
    pub at: Vec<f64>,
    /// (XᵀX)⁻¹ of the sources around their mean, row after row.
    pub spread: Vec<Vec<f64>>,
}

impl Certainty {
    /// Standard error, in each coordinate, of where the map puts `x`, µm. `None` when the numbers do not suit each other.
    pub fn error_um(&self, x: &[f64]) -> Option<f64> {
        let off: Vec<f64> = x.iter().zip(&self.at).map(|(x, at)| x - at).collect();
        if off.len() != x.len() || self.samples == 0 {
            return None;
        }
        self.root(1.0 / self.samples as f64 + self.form(&off)?)
    }

    /// Standard error, in each coordinate, of the difference that the map makes of a step, µm: what is known at one end cancels.
    pub fn step_error_um(&self, step: &[f64]) -> Option<f64> {
        self.root(self.form(step)?)
    }

    fn form(&self, d: &[f64]) -> Option<f64> {
        let square = self.spread.len() == d.len() && self.spread.iter().all(|row| row.len() == d.len());
        let row = |row: &Vec<f64>| row.iter().zip(d).map(|(g, d)| g * d).sum::<f64>();
        square.then(|| self.spread.iter().zip(d).map(|(r, d)| d * row(r)).sum())
    }

    fn root(&self, squared: f64) -> Option<f64> {
        let error = self.noise_um * squared.sqrt();
        error.is_finite().then_some(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_through_points_is_known_best_amid_them() {
        // The textbook's line: Var(ŷ) = σ²·(1/n + (x − x̄)²/Σ(x − x̄)²).
        let x = [1.0, 2.0, 4.0, 7.0];
        let at = 3.5;
        let squares: f64 = x.iter().map(|x: &f64| (x - at).powi(2)).sum();
        let line = Certainty {
            noise_um: 0.4,
            freedom: 2,
            samples: 4,
            standard_errors: vec![0.4 / squares.sqrt()],
            at: vec![at],
            spread: vec![vec![1.0 / squares]],
        };
        for v in [3.5f64, 0.0, 20.0] {
            let known = 0.4 * (0.25 + (v - at).powi(2) / squares).sqrt();
            assert!((line.error_um(&[v]).unwrap() - known).abs() < 1e-12);
        }
        assert!((line.step_error_um(&[2.0]).unwrap() - 2.0 * line.standard_errors[0]).abs() < 1e-12);
        assert_eq!(line.error_um(&[1.0, 2.0]), None);
        assert_eq!(Certainty { spread: vec![], ..line }.error_um(&[1.0]), None);
    }
}
