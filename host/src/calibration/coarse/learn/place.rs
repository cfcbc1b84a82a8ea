//! From markers seen now to each manipulator's coarse registration.

use super::{LearnError, Learned};
use crate::calibration::coarse::{Degrees, MarkerId, Millimetres, Registration, graph::MarkerPose};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::Serialize;
use std::collections::BTreeMap;

/// A manipulator's joint positions P_R, µm.
pub type Joints = Vector3<f64>;

/// Where everything motorised stood when the pictures were taken.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Now {
    /// The microscope's position P_M, µm.
    pub microscope_um: Vector3<f64>,
    /// The manipulators' joints, by marker.
    pub joints_um: BTreeMap<MarkerId, Joints>,
}

/// What the ref of coarse registrations was taken from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RefFrame {
    /// ref, by the objective's marker.
    Objective,
    /// ref, as it lay to the substrate when the markers were learned.
    LearnedSubstrate,
    /// The substrate's: x as its marker's, z up, origin at its marker. Neither the objective's marker nor a fine calibration is known.
    Substrate,
}

/// A manipulator's coarse registration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Coarse {
    /// The first three rows of `T_man_ref`: µm from joints, µm.
    pub man_to_ref_um: [[f64; 4]; 3],
    /// The tip in ref now, µm; none when it was never clicked or calibrated.
    pub tip_um: Option<[f64; 3]>,
    /// Expected root mean square error of the tip.
    pub tip_error: Millimetres,
    /// The pipette's descent Θ.
    pub theta: Option<Degrees>,
    /// The pipette's azimuth ψ.
    pub psi: Option<Degrees>,
    /// Expected root mean square error of directions.
    pub direction_error: Degrees,
    /// What ref is.
    pub frame: RefFrame,
}

/// The direction of descent Θ and azimuth ψ in ref, z up: (cosΘ cosψ, cosΘ sinψ, −sinΘ).
pub(super) fn direction(theta: Degrees, psi: Degrees) -> Vector3<f64> {
    let ((st, ct), (sp, cp)) = (theta.0.to_radians().sin_cos(), psi.0.to_radians().sin_cos());
    Vector3::new(ct * cp, ct * sp, -st)
}

/// Coarse registrations of all learned manipulators whose markers were placed.
///
/// # Errors
/// [`LearnError::NotPlaced`] when the joints' positions of a manipulator are missing from `now`.
pub fn place(seen: &Registration, learned: &Learned, now: &Now) -> Result<BTreeMap<MarkerId, Coarse>, LearnError> {
    let (to_ref, frame, by) = link(seen, learned, now);
    let mut all = BTreeMap::new();
    for (id, marker) in &learned.manipulators {
        let Some(pose) = seen.markers.get(id) else { continue };
        let joints = if marker.rides {
            *now.joints_um.get(id).ok_or_else(|| LearnError::NotPlaced { marker: *id, set: "now".into() })?
        } else {
            marker.joints_um
        };
        let to_marker = to_ref * pose.pose;
        let turn = to_marker.rotation.to_rotation_matrix().into_inner();
        let axes: Matrix3<f64> = turn * marker.axes;
        let tip = marker.tip_mm.map(|t| (to_marker * t).coords * 1000.0);
        let origin = tip.unwrap_or(to_marker.translation.vector * 1000.0) - axes * joints;
        let u = marker.pipette.map(|p| turn * p);
        let here = now.joints_um.get(id).map_or(joints, |j| *j);
        all.insert(
            *id,
            Coarse {
                man_to_ref_um: std::array::from_fn(|i| {
                    std::array::from_fn(|j| if j < 3 { axes[(i, j)] } else { origin[i] })
                }),
                tip_um: tip.map(|_| (axes * here + origin).into()),
                tip_error: tip_error(pose, marker.tip_mm, by),
                theta: u.map(|u| Degrees((-u.z).clamp(-1.0, 1.0).asin().to_degrees())),
                psi: u.map(|u| Degrees(u.y.atan2(u.x).to_degrees())),
                direction_error: Degrees(pose.orientation.0.hypot(by.map_or(0.0, |b| b.orientation.0))),
                frame,
            },
        );
    }
    Ok(all)
}

/// Substrate marker to ref, mm; what that is; and the objective's marker if it was used.
fn link<'a>(
    seen: &'a Registration,
    learned: &Learned,
    now: &Now,
) -> (Isometry3<f64>, RefFrame, Option<&'a MarkerPose>) {
    for (id, objective) in &learned.objectives {
        if let Some(pose) = seen.markers.get(id) {
            let to_mic = (pose.pose * objective.mic).inverse();
            let to_ref = Translation3::from(now.microscope_um / 1000.0) * to_mic;
            return (to_ref, RefFrame::Objective, Some(pose));
        }
    }
    match learned.substrate {
        Some(to_ref) => (to_ref, RefFrame::LearnedSubstrate, None),
        None => {
            // The marker's z goes into the paper, ref's up.
            let over = Rotation3::from_matrix_unchecked(Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)));
            let over = UnitQuaternion::from_rotation_matrix(&over);
            (Isometry3::from_parts(Translation3::identity(), over), RefFrame::Substrate, None)
        }
    }
}

/// Errors of the marker's position, of its orientation over the lever to the tip, and of the objective's marker likewise.
fn tip_error(pose: &MarkerPose, tip_mm: Option<Point3<f64>>, by: Option<&MarkerPose>) -> Millimetres {
    let lever = tip_mm.map_or(0.0, |t| t.coords.norm());
    let turned = |pose: &MarkerPose, lever: f64| pose.position.0.hypot(lever * pose.orientation.0.to_radians());
    let own = turned(pose, lever);
    let other = by.map_or(0.0, |b| turned(b, (b.pose.translation.vector - pose.pose.translation.vector).norm()));
    Millimetres(own.hypot(other))
}
