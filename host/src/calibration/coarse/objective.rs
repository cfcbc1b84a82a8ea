//! The objective's height after a turn of the coarse focus knob, which no motor knows of.
//!
//! Two ways lead to it: a tip, focused, that the old calibration has at another height; or the coarse view of the objective's marker before and
//! after the turn. Everything else of the calibration stays as it is.

use super::graph::MarkerPose;
use super::{Degrees, Millimetres};
use nalgebra::{Isometry3, Vector3};
use serde::Serialize;
use thiserror::Error;

/// How the focal point moved in ref against where the microscope's axes have it: what is to be added to the objective's κ, µm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct HeightChange {
    /// Upwards, µm.
    pub z_um: f64,
    /// Expected error, µm.
    pub error_um: f64,
}

/// Why the height cannot be told.
#[derive(Debug, Error, PartialEq)]
pub enum HeightError {
    /// It moved sideways too.
    #[error(
        "the objective moved sideways by {sideways} while {up} upwards: a focus knob does not do that; register the markers anew"
    )]
    Sideways {
        /// Along x and y.
        sideways: Millimetres,
        /// Along z.
        up: Millimetres,
    },
    /// It turned.
    #[error(
        "the objective's marker turned by {0}: it came loose, or another objective is in use; register the markers anew"
    )]
    Turned(Degrees),
    /// A focus that is no number.
    #[error("the tip's height {0} µm is no number")]
    NotFinite(f64),
}

/// From one focused tip: where the microscope now focuses it, and where the calibration expects its height, both z in ref, µm.
///
/// # Errors
/// [`HeightError::NotFinite`].
pub fn from_tip(expected_z_um: f64, focused_z_um: f64, focus_error_um: f64) -> Result<HeightChange, HeightError> {
    for z in [expected_z_um, focused_z_um, focus_error_um] {
        if !z.is_finite() {
            return Err(HeightError::NotFinite(z));
        }
    }
    Ok(HeightChange { z_um: expected_z_um - focused_z_um, error_um: focus_error_um })
}

/// Sideways moves that are the pictures' errors and the stand's play, mm, and turns, degrees.
const SIDEWAYS_MM: f64 = 0.5;
const TURN_DEG: f64 = 1.0;

/// From the coarse view: the objective's marker before and after (marker → substrate marker), the motors' own move between (µm, in ref), and
/// how the substrate lies in ref.
///
/// # Errors
/// [`HeightError::Sideways`] and [`HeightError::Turned`]: what happened is no turn of the focus knob.
pub fn from_view(
    before: &MarkerPose,
    after: &MarkerPose,
    motors_um: Vector3<f64>,
    substrate_to_ref: &Isometry3<f64>,
) -> Result<HeightChange, HeightError> {
    let turn = Degrees(before.pose.rotation.angle_to(&after.pose.rotation).to_degrees());
    let error_deg = before.orientation.0.hypot(after.orientation.0);
    if turn.0 > TURN_DEG + 3.0 * error_deg {
        return Err(HeightError::Turned(turn));
    }
    let moved = after.pose.translation.vector - before.pose.translation.vector;
    let moved = substrate_to_ref.rotation * moved - motors_um / 1000.0;
    let error_mm = before.position.0.hypot(after.position.0);
    let sideways = moved.xy().norm();
    if sideways > SIDEWAYS_MM + 3.0 * error_mm + 0.02 * moved.z.abs() {
        return Err(HeightError::Sideways { sideways: Millimetres(sideways), up: Millimetres(moved.z) });
    }
    Ok(HeightChange { z_um: moved.z * 1000.0, error_um: error_mm * 1000.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    fn marker(x: f64, y: f64, z: f64, degrees: f64) -> MarkerPose {
        let turn = UnitQuaternion::from_euler_angles(0.3, 0.0, degrees.to_radians());
        let pose = Isometry3::from_parts(Translation3::new(x, y, z), turn);
        MarkerPose { pose, position: Millimetres(0.05), orientation: Degrees(0.1) }
    }

    /// The substrate's marker as it lies on the table: z into the paper, so down.
    fn lying() -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::identity(),
            UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0),
        )
    }

    #[test]
    fn the_knob_is_told_from_the_motors() {
        let before = marker(0.0, -50.0, -40.0, 0.0);
        // Up by 3.2 mm in all, 1 mm of it and 0.5 mm sideways by motor.
        let after = marker(0.5, -50.0, -43.2, 0.0);
        let change = from_view(&before, &after, Vector3::new(500.0, 0.0, 1000.0), &lying()).unwrap();
        assert!((change.z_um - 2200.0).abs() < 1e-6 && change.error_um < 80.0, "{change:?}");
    }

    #[test]
    fn what_is_no_turn_of_the_knob_is_refused() {
        let before = marker(0.0, -50.0, -40.0, 0.0);
        let aside = from_view(&before, &marker(2.0, -50.0, -42.0, 0.0), Vector3::zeros(), &lying());
        assert!(matches!(aside, Err(HeightError::Sideways { .. })), "{aside:?}");
        let turned = from_view(&before, &marker(0.0, -50.0, -42.0, 60.0), Vector3::zeros(), &lying());
        assert!(matches!(turned, Err(HeightError::Turned(_))), "{turned:?}");
    }

    #[test]
    fn a_tip_in_focus_gives_it_to_the_focus_own_error() {
        let change = from_tip(120.0, 95.5, 0.4).unwrap();
        assert_eq!((change.z_um, change.error_um), (24.5, 0.4));
        assert!(matches!(from_tip(f64::NAN, 1.0, 0.1), Err(HeightError::NotFinite(_))));
    }
}
