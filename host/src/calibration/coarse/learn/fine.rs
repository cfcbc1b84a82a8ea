//! Tip, axes and focal point in the markers' frames, from a fine calibration.
//!
//! The fine calibration knows ref, the pictures know the substrate's marker. They are linked by what both see: markers that
//! ride along known joint moves give the rotation, clicked tips the translation and, when far apart, rotation too.

use super::moves::Stop;
use super::{LearnError, Learned, ManipulatorMarker, ObjectiveMarker};
use crate::calibration::coarse::MarkerId;
use crate::calibration::coarse::learn::place::direction;
use crate::calibration::coarse::{Degrees, graph::MarkerPose};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::collections::BTreeMap;

/// A manipulator's fine calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fine {
    /// Linear part of `T_man_ref`: µm in ref per µm of joint.
    pub axes: Matrix3<f64>,
    /// Translation of `T_man_ref`, µm.
    pub origin_um: Vector3<f64>,
    /// The pipette's descent and azimuth Θ, ψ in ref.
    pub pipette: Option<[Degrees; 2]>,
}

impl Fine {
    /// The tip in ref with the joints there, mm.
    fn tip_mm(&self, joints_um: &Vector3<f64>) -> Vector3<f64> {
        (self.axes * joints_um + self.origin_um) / 1000.0
    }
}

/// The objective as it was photographed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Objective {
    /// Its marker.
    pub marker: MarkerId,
    /// The marker's pose, marker to substrate marker.
    pub pose: MarkerPose,
    /// The microscope's position P_M, µm.
    pub microscope_um: Vector3<f64>,
}

/// How far the tips clicked may be from where the fine calibration has them, mm.
const OFF_MM: f64 = 2.0;

/// Learns all markers. Each manipulator's stops need joint moves or clicked tips.
///
/// # Errors
/// [`LearnError::Link`] when moves and clicks leave the link between substrate and ref open, [`LearnError::Contradiction`].
pub fn learn(
    manipulators: &BTreeMap<MarkerId, (Fine, Vec<Stop>)>,
    objective: Option<&Objective>,
) -> Result<Learned, LearnError> {
    let to_ref = link(manipulators)?;
    let back = to_ref.inverse();
    let mut learned = Learned { substrate: Some(to_ref), ..Learned::default() };
    for (id, (fine, stops)) in manipulators {
        let Some(stop) = stops.first() else { return Err(LearnError::Moves { marker: *id }) };
        let turn = (stop.marker.rotation.inverse() * back.rotation).to_rotation_matrix().into_inner();
        let tip = back * Point3::from(fine.tip_mm(&stop.joints_um));
        learned.manipulators.insert(
            *id,
            ManipulatorMarker {
                axes: turn * fine.axes,
                tip_mm: Some(stop.marker.inverse_transform_point(&tip)),
                joints_um: stop.joints_um,
                pipette: fine.pipette.map(|[theta, psi]| turn * direction(theta, psi)),
                rides: rides(stops),
            },
        );
    }
    if let Some(o) = objective {
        // p_mic = p_ref − P_M (4.4)
        let ref_to_mic = Translation3::from(-o.microscope_um / 1000.0);
        let mic = (ref_to_mic * to_ref * o.pose.pose).inverse();
        learned.objectives.insert(o.marker, ObjectiveMarker { mic });
    }
    Ok(learned)
}

/// Whether the marker moves with the joints; one that was seen at one stop only is taken to.
fn rides(stops: &[Stop]) -> bool {
    let apart =
        |f: &dyn Fn(&Stop) -> Vector3<f64>| stops.iter().map(|s| (f(s) - f(&stops[0])).norm()).fold(0.0, f64::max);
    let joints = apart(&|s| s.joints_um / 1000.0);
    joints < 0.5 || apart(&|s| s.marker.translation.vector) > 0.3 * joints
}

/// Substrate marker to ref, mm.
fn link(manipulators: &BTreeMap<MarkerId, (Fine, Vec<Stop>)>) -> Result<Isometry3<f64>, LearnError> {
    // Groups of points, known in both frames up to a shift of their own; the tips share one, which is the translation.
    let mut groups: Vec<Vec<(Vector3<f64>, Vector3<f64>)>> = Vec::new();
    let mut tips = Vec::new();
    for (fine, stops) in manipulators.values() {
        if stops.len() > 1 && rides(stops) {
            let pair = |s: &Stop| (s.marker.translation.vector, fine.axes * s.joints_um / 1000.0);
            groups.push(stops.iter().map(pair).collect());
        }
        tips.extend(stops.iter().filter_map(|s| Some((s.tip_mm?.coords, fine.tip_mm(&s.joints_um)))));
    }
    let mean = |group: &[(Vector3<f64>, Vector3<f64>)]| {
        let count = group.len() as f64;
        group.iter().fold((Vector3::zeros(), Vector3::zeros()), |m, p| (m.0 + p.0 / count, m.1 + p.1 / count))
    };
    if tips.is_empty() {
        return Err(LearnError::Link);
    }
    let mut mixed = Matrix3::zeros();
    for (group, weight) in groups.iter().map(|g| (g, 1.0)).chain([(&tips, CLICK_WEIGHT)]) {
        let (a, b) = mean(group);
        mixed += group.iter().map(|(p, q)| (q - b) * (p - a).transpose()).sum::<Matrix3<f64>>() * weight;
    }
    let svd = mixed.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Err(LearnError::Link) };
    // Two independent directions at least, 1 mm long.
    if svd.singular_values[1] < 1.0 {
        return Err(LearnError::Link);
    }
    let sign = (u * v_t).determinant().signum();
    let turn = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn));
    let (a, b) = mean(&tips);
    let to_ref = Isometry3::from_parts(Translation3::from(b - rotation * a), rotation);
    let off = tips.iter().map(|(p, q)| (to_ref * Point3::from(*p) - Point3::from(*q)).norm_squared()).sum::<f64>();
    let mm = (off / tips.len() as f64).sqrt();
    if mm > OFF_MM { Err(LearnError::Contradiction { mm }) } else { Ok(to_ref) }
}

/// A click is worth this much of a marker's position: its depth is ten times worse.
const CLICK_WEIGHT: f64 = 0.01;
