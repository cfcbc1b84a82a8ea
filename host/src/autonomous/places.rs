//! Where to look next, and whether enough has been seen.

use crate::calibration::robust::{Model, Solution};
use crate::calibration::statistics;
use nalgebra::SVector;

/// The largest standard error (in one coordinate) of a map at some places, from the inliers' residuals; `None` while there
/// are no more inliers than the map takes.
pub fn worst_error<const D: usize>(solution: &Solution<D>, places: &[SVector<f64, D>]) -> Option<f64> {
    let sigma = statistics::noise(Model::Affine, solution)?;
    let leverage = places.iter().map(|p| solution.fit.leverage(p)).fold(0.0, f64::max);
    Some(sigma * leverage.sqrt())
}

/// The place that tells most: where the map is weakest.
pub fn weakest<const D: usize>(solution: &Solution<D>, places: &[SVector<f64, D>]) -> Option<usize> {
    let leverage = |i: usize| solution.fit.leverage(&places[i]);
    (0..places.len()).max_by(|a, b| leverage(*a).total_cmp(&leverage(*b)))
}

/// How many samples it may take in all: standard errors fall with the root of their number.
pub fn expected_samples(now: usize, error: f64, asked: f64, least: usize, most: usize) -> usize {
    let wanted = now as f64 * (error / asked).powi(2);
    (wanted.ceil() as usize).clamp(least.max(now + 1), most.max(now + 1))
}
