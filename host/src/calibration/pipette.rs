//! A pipette's direction in ref: descent Θ and azimuth ψ, from points along its shank or from a registered axis.

use super::chain::angles;
use super::error::CalibrationError;
use super::frames::Displacement;
use super::frames::Ref;
use nalgebra::{Matrix3, Vector3};

/// A pipette's direction of advance.
#[derive(Clone, Debug, PartialEq)]
pub struct PipetteFit {
    /// A unit vector in ref.
    pub direction: Displacement<Ref>,
    /// Θ, degrees: how steeply an advance goes down.
    pub descent_deg: f64,
    /// ψ, degrees: where an advance goes, from x towards y.
    pub azimuth_deg: f64,
    /// RMS distance of the points from the line, µm; 0 for an axis.
    pub rms_um: f64,
}

impl PipetteFit {
    fn new(direction: Vector3<f64>, rms_um: f64) -> Self {
        let direction: Displacement<Ref> = direction.normalize().into();
        let (descent, azimuth) = angles(direction);
        Self { direction, descent_deg: descent.to_degrees(), azimuth_deg: azimuth.to_degrees(), rms_um }
    }
}

/// The shank's line through points in focus along it, in ref, from the tip upwards (the first one nearest the tip): the
/// line of least squared distances.
///
/// # Errors
/// [`CalibrationError::TooFew`] below 2 points, [`CalibrationError::TooClose`] when they span less than 5 µm, and
/// [`CalibrationError::Units`] when they are not along a line.
pub fn from_shank(points: &[Vector3<f64>]) -> Result<PipetteFit, CalibrationError> {
    if points.len() < 2 {
        return Err(CalibrationError::TooFew { what: "a shank", have: points.len(), need: 2 });
    }
    let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let spread: Matrix3<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
    let eigen = spread.symmetric_eigen();
    let main = eigen.eigenvalues.imax();
    let axis: Vector3<f64> = eigen.eigenvectors.column(main).into();
    let along: Vec<f64> = points.iter().map(|p| (p - mean).dot(&axis)).collect();
    let extent = along.iter().copied().fold(f64::MIN, f64::max) - along.iter().copied().fold(f64::MAX, f64::min);
    if extent < 5.0 {
        return Err(CalibrationError::TooClose { what: "shank", extent, unit: "µm", least: 5.0 });
    }
    let across: f64 = (0..3).filter(|k| *k != main).map(|k| eigen.eigenvalues[k].max(0.0)).sum();
    let rms_um = (across / points.len() as f64).sqrt();
    if rms_um > 0.2 * extent {
        return Err(CalibrationError::Units(format!(
            "the shank's points are not along a line: {rms_um:.1} µm off it over {extent:.1} µm; focus on the shank itself"
        )));
    }
    // An advance goes from the shank to the tip, which is the first point.
    let towards_tip = if along[0] < along[points.len() - 1] { -axis } else { axis };
    Ok(PipetteFit::new(towards_tip, rms_um))
}

/// The direction of a registered axis: the column of `T_man_ref` that the pipette is mounted along, pointing down.
pub fn from_axis(linear: &Matrix3<f64>, axis: usize) -> PipetteFit {
    let column: Vector3<f64> = linear.column(axis).into();
    PipetteFit::new(if column.z > 0.0 { -column } else { column }, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::chain::direction;

    #[test]
    fn the_shanks_line_gives_the_angles_it_was_made_with() {
        let u = direction(31f64.to_radians(), 2.0).coordinates;
        let points: Vec<_> = (0..6)
            .map(|k| Vector3::new(7.0, 8.0, 9.0) - u * (20.0 * f64::from(k)) + Vector3::z() * 0.1 * f64::from(k % 2))
            .collect();
        let fit = from_shank(&points).unwrap();
        assert!((fit.descent_deg - 31.0).abs() < 0.2 && (fit.azimuth_deg - 2f64.to_degrees()).abs() < 0.2, "{fit:?}");
        assert!(from_shank(&points[..1]).is_err() && from_shank(&[u, u * 1.1]).is_err());
    }

    #[test]
    fn an_axis_points_down() {
        let fit = from_axis(&Matrix3::from_columns(&[Vector3::new(-0.8, 0.0, 0.6), Vector3::y(), Vector3::z()]), 0);
        assert!((fit.descent_deg - 36.87).abs() < 0.01 && fit.azimuth_deg.abs() < 1e-9);
    }
}
