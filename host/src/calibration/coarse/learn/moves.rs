//! Axes from photographs of known moves, the tip and the pipette's direction from clicks: no fine calibration needed.

use super::{LearnError, ManipulatorMarker};
use crate::calibration::coarse::MarkerId;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

/// A manipulator photographed with its joints somewhere.
#[derive(Clone, Debug, PartialEq)]
pub struct Stop {
    /// The joints' positions, µm.
    pub joints_um: Vector3<f64>,
    /// Its marker, marker to substrate marker, mm.
    pub marker: Isometry3<f64>,
    /// The tip clicked, in the substrate marker's frame, mm.
    pub tip_mm: Option<Point3<f64>>,
    /// A point of the pipette towards its holder clicked, likewise.
    pub shank_mm: Option<Point3<f64>>,
}

/// Least extent of the moves along their weakest direction, mm, and how far markers may lie off what the joints say.
const LEAST_MM: f64 = 1.0;
const OFF_MM: f64 = 0.7;

/// Learns a marker that rides on what moves, from at least four stops: rest and a move of each joint.
///
/// # Errors
/// [`LearnError::Moves`] when the stops do not span space, [`LearnError::NotLinear`] when the marker does not follow the joints.
pub fn learn(marker: MarkerId, stops: &[Stop]) -> Result<ManipulatorMarker, LearnError> {
    let (axes, off) = axes(stops).ok_or(LearnError::Moves { marker })?;
    if off > OFF_MM {
        return Err(LearnError::NotLinear { marker, mm: off });
    }
    // Turned into the marker's frame as it was at the first stop; the marker rides without turning.
    let first = &stops[0];
    let to_marker = |s: &Stop, v: Vector3<f64>| s.marker.rotation.inverse() * v;
    let axes = first.marker.rotation.inverse().to_rotation_matrix().into_inner() * axes;
    let tips: Vec<Vector3<f64>> =
        stops.iter().filter_map(|s| s.tip_mm.map(|t| s.marker.inverse_transform_point(&t).coords)).collect();
    let directions: Vec<Vector3<f64>> =
        stops.iter().filter_map(|s| Some(to_marker(s, (s.tip_mm? - s.shank_mm?).try_normalize(1e-6)?))).collect();
    let mean = |v: &[Vector3<f64>]| (!v.is_empty()).then(|| v.iter().sum::<Vector3<f64>>() / v.len() as f64);
    Ok(ManipulatorMarker {
        axes,
        tip_mm: mean(&tips).map(Point3::from),
        joints_um: first.joints_um,
        pipette: mean(&directions).and_then(|d| d.try_normalize(1e-6)),
        rides: true,
    })
}

/// The joints' axes in the substrate marker's frame, mm per mm, and the root mean square of what they leave over, mm.
pub(super) fn axes(stops: &[Stop]) -> Option<(Matrix3<f64>, f64)> {
    let count = stops.len() as f64;
    let at = |s: &Stop| (s.joints_um / 1000.0, s.marker.translation.vector);
    let (joints, marks): (Vec<_>, Vec<_>) = stops.iter().map(at).unzip();
    let middle = |v: &[Vector3<f64>]| v.iter().sum::<Vector3<f64>>() / count;
    let (a, b) = (middle(&joints), middle(&marks));
    let spread: Matrix3<f64> = joints.iter().map(|j| (j - a) * (j - a).transpose()).sum();
    let mixed: Matrix3<f64> = joints.iter().zip(&marks).map(|(j, m)| (m - b) * (j - a).transpose()).sum();
    let weakest = spread.symmetric_eigen().eigenvalues.min().max(0.0).sqrt();
    if !(weakest >= LEAST_MM) {
        return None;
    }
    let axes = mixed * spread.try_inverse()?;
    let off = joints.iter().zip(&marks).map(|(j, m)| (m - b - axes * (j - a)).norm_squared()).sum::<f64>();
    Some((axes, (off / count).sqrt()))
}
