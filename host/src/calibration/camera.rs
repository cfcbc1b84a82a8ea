//! The camera's matrix: a point fixed in ref, seen from several microscope positions.
//!
//! The point stays, so P_M = c − αA·P_I: an affine map from picture to microscope. A stage that moves the sample moves
//! the point with it, and the sign is the other one.

use super::chain::Sensor;
use super::error::CalibrationError;
use super::geometry::{self, Span};
use super::robust::{Ambiguity, Estimator, Model, Settings, Solution, solve};
use super::samples::{CameraSample, on_sensor};
use super::statistics;
use crate::rig::Moves;
use nalgebra::{Matrix2, Vector2};

/// Options of a solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Largest error of an inlier, µm; from the data if left out.
    pub tolerance_um: Option<f64>,
    /// Of the random draws.
    pub seed: u64,
    /// Robust or plain.
    pub estimator: Estimator,
}

/// A camera's matrix, and what can be read off it.
#[derive(Clone, Debug)]
pub struct CameraFit {
    /// αA: columns are what a pixel right and a pixel down are in µm of mic.
    pub matrix_um_per_px: Matrix2<f64>,
    /// Standard errors; `None` when three points fit exactly.
    pub standard_errors: Option<Matrix2<f64>>,
    /// What the solver found, map from px (picture's centre 0, 0) to µm.
    pub solution: Solution<2>,
    /// The pictures' points, px from the centre.
    pub image_px: Vec<Vector2<f64>>,
    /// Leave-one-out error of each inlier, µm.
    pub leave_one_out_um: Vec<Option<f64>>,
}

/// Pixel sizes beyond these are no microscope's, µm.
const PIXEL_UM: std::ops::RangeInclusive<f64> = 0.005..=50.0;
/// Smallest extent that makes sense, px.
const LEAST_PX: f64 = 10.0;

impl CameraFit {
    /// |A₁|, |A₂|: a pixel's size, µm.
    pub fn pixel_um(&self) -> (f64, f64) {
        (self.matrix_um_per_px.column(0).norm(), self.matrix_um_per_px.column(1).norm())
    }

    /// atan2(A₂₁, A₁₁).
    pub fn rotation_deg(&self) -> f64 {
        self.matrix_um_per_px[(1, 0)].atan2(self.matrix_um_per_px[(0, 0)]).to_degrees()
    }

    /// ∠(A₁, A₂) − 90°.
    pub fn skew_deg(&self) -> f64 {
        let (a, b) = (self.matrix_um_per_px.column(0), self.matrix_um_per_px.column(1));
        (a.dot(&b) / (a.norm() * b.norm())).clamp(-1.0, 1.0).acos().to_degrees() - 90.0
    }

    /// Whether the picture is mirrored: det A < 0.
    pub fn mirrored(&self) -> bool {
        self.matrix_um_per_px.determinant() < 0.0
    }

    /// RMS of the inliers' residuals in the picture.
    pub fn rms_px(&self) -> f64 {
        let inverse = self.solution.fit.map.linear.try_inverse().unwrap_or_else(Matrix2::zeros);
        let chosen = self.solution.chosen();
        let squares: f64 = chosen.iter().map(|&i| (inverse * self.solution.residuals[i]).norm_squared()).sum();
        (squares / chosen.len() as f64).sqrt()
    }
}

/// Solves the camera's matrix.
///
/// # Errors
/// [`CalibrationError`], naming the row or what to move.
pub fn fit(
    samples: &[CameraSample],
    sensor: Sensor,
    moves: Moves,
    options: &Options,
) -> Result<CameraFit, CalibrationError> {
    if samples.len() < 3 {
        return Err(CalibrationError::TooFew { what: "the camera", have: samples.len(), need: 3 });
    }
    let src: Vec<_> = samples.iter().map(|s| sensor.to_image(s.pixel).coordinates.xy()).collect();
    let dst: Vec<_> = samples.iter().map(|s| s.mic_um).collect();
    if samples.iter().all(|s| (s.mic_um - Vector2::new(s.pixel.x_px, s.pixel.y_px)).norm() < 1e-6) {
        let what = "mic_x_um and mic_y_um hold the same numbers as image_x_px and image_y_px: the microscope's \
                    position belongs there, in µm";
        return Err(CalibrationError::Units(what.into()));
    }
    on_sensor(sensor, samples.iter().map(|s| s.pixel))?;
    geometry::check(&dst, Span { what: "microscope", unit: "µm", least: 0.1, dimensions: 2 })?;
    geometry::check(&src, Span { what: "picture", unit: "px", least: LEAST_PX, dimensions: 2 })?;
    let settings = Settings {
        tolerance: options.tolerance_um,
        seed: options.seed,
        estimator: options.estimator,
        ..Settings::new(Model::Affine)
    };
    let solution = solve(&src, &dst, &settings)?;
    if let Some(ambiguity) = &solution.ambiguity {
        return Err(CalibrationError::Ambiguous(two_answers(ambiguity, &solution.inliers)));
    }
    let sign = if moves == Moves::Objective { -1.0 } else { 1.0 };
    let fit = CameraFit {
        matrix_um_per_px: solution.fit.map.linear * sign,
        standard_errors: statistics::standard_errors(Model::Affine, &src, &solution).map(|e| e.linear),
        leave_one_out_um: statistics::leave_one_out(Model::Affine, &src, &dst, &solution.chosen()),
        image_px: src,
        solution,
    };
    let (x, y) = fit.pixel_um();
    if !PIXEL_UM.contains(&x) || !PIXEL_UM.contains(&y) {
        return Err(CalibrationError::Units(format!(
            "a pixel would be {x:.4} x {y:.4} µm, which no microscope has: are mic_x_um and mic_y_um in µm and \
             image_x_px and image_y_px in px?"
        )));
    }
    Ok(fit)
}

/// Which rows speak for which of two maps.
pub(super) fn two_answers<const D: usize>(ambiguity: &Ambiguity<D>, inliers: &[bool]) -> String {
    let list = |of: &[bool], not: &[bool]| {
        let rows: Vec<String> = (0..of.len()).filter(|&i| of[i] && !not[i]).map(|i| (i + 1).to_string()).collect();
        rows.join(", ")
    };
    match ambiguity {
        Ambiguity::Rival { inliers: other, .. } => format!(
            "two maps explain these samples as well: one with row {}, one with row {}; take more samples near those",
            list(inliers, other),
            list(other, inliers)
        ),
        Ambiguity::Unlikely { axis, scale } => format!(
            "the {} axis rests on one sample and would be {scale:.2} times its length: take more samples along it",
            ["x", "y", "z"][*axis.min(&2)]
        ),
    }
}
