//! What markers carry: from a marker's pose to the tip, the joint axes and the focal point.
//!
//! A marker shows the body it sticks to, not the tip and not the axes. Both are learned once and kept with the marker: from a fine calibration
//! ([`fine`]), or by photographing known moves and clicking on the tip ([`moves`]). From then on pictures of the markers alone give each
//! manipulator's registration, good to a millimetre.

pub mod fine;
pub mod moves;
mod place;
mod plain;

pub use place::{Coarse, Joints, Now, RefFrame, place};

use super::{MarkerId, StereoCamera};
use nalgebra::{Isometry3, Matrix3, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use thiserror::Error;

/// What the marker on a manipulator knows, all in the marker's frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ManipulatorMarker {
    /// How the tip moves with the joints, one joint a column: mm per mm.
    #[serde(with = "plain::matrix")]
    pub axes: Matrix3<f64>,
    /// The tip at `joints_um`, mm.
    #[serde(default, with = "plain::point")]
    pub tip_mm: Option<Point3<f64>>,
    /// The joints' positions at which `tip_mm` and the marker were seen together, µm.
    #[serde(with = "plain::vector")]
    pub joints_um: Vector3<f64>,
    /// The pipette's direction, from its holder to its tip, of length 1.
    #[serde(default, with = "plain::direction")]
    pub pipette: Option<Vector3<f64>>,
    /// Whether the marker moves with the tip, or sticks to the base.
    pub rides: bool,
}

/// What the marker on the objective knows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObjectiveMarker {
    /// The frame mic, origin at the focal point, in the marker's frame; mm.
    #[serde(with = "plain::pose")]
    pub mic: Isometry3<f64>,
}

/// All that was learned.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Learned {
    /// Markers on manipulators.
    pub manipulators: BTreeMap<MarkerId, ManipulatorMarker>,
    /// Markers on the objective.
    pub objectives: BTreeMap<MarkerId, ObjectiveMarker>,
    /// Substrate marker to ref, mm, valid while the substrate stays where it is.
    #[serde(default, with = "plain::maybe_pose")]
    pub substrate: Option<Isometry3<f64>>,
}

/// The same point clicked in both pictures of a place.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Click {
    /// Which place.
    pub place: super::Place,
    /// In the left picture, px.
    pub left: [f64; 2],
    /// In the right picture, px.
    pub right: [f64; 2],
}

/// Why nothing can be learned.
#[derive(Debug, Error, PartialEq)]
pub enum LearnError {
    /// A click at a place that is not registered.
    #[error("a click names place {0}, from which no markers were placed: give the number K of its place_K_left.png")]
    UnknownPlace(super::Place),
    /// Two clicks that are not the same point.
    #[error(
        "place {place}: the clicks left and right are {px:.1} px from showing one point: click the same point in both pictures"
    )]
    ClicksApart {
        /// Which place.
        place: super::Place,
        /// Distance from the other's ray, px.
        px: f64,
    },
    /// Clicks at several places that are not the same point.
    #[error("the clicks give points {mm:.1} mm apart from different places: click the same point everywhere")]
    PlacesApart {
        /// The greatest distance.
        mm: f64,
    },
    /// Moves that do not span space.
    #[error(
        "marker {marker}: the joints' positions do not determine the axes: photograph the rest and a move of each of the three joints, 5 mm or more"
    )]
    Moves {
        /// On which manipulator.
        marker: MarkerId,
    },
    /// A marker missing from a set.
    #[error("marker {marker} could not be placed in set {set}: it has to be seen in every set that names it")]
    NotPlaced {
        /// Which.
        marker: MarkerId,
        /// Name of the set.
        set: String,
    },
    /// The marker does not move as the joints do.
    #[error(
        "marker {marker}: its moves are off a straight path by {mm:.2} mm: are the joints' positions those of the pictures, in µm?"
    )]
    NotLinear {
        /// Which.
        marker: MarkerId,
        /// Root mean square distance.
        mm: f64,
    },
    /// Fine calibration and pictures contradict each other.
    #[error("the fine calibration and what the pictures show differ by {mm:.2} mm: calibrate again, or click again")]
    Contradiction {
        /// Root mean square distance.
        mm: f64,
    },
    /// Too few points to link substrate and ref.
    #[error(
        "the sets do not determine how substrate and ref lie to each other: give moves of at least two joints, and one click on a tip"
    )]
    Link,
    /// No clicks.
    #[error("no clicks were given for marker {marker}: click on the tip in both pictures of a place")]
    NoClicks {
        /// On which manipulator.
        marker: MarkerId,
    },
}

/// Clicks may miss each other by this, px and mm.
const CLICK_PX: f64 = 4.0;
const CLICKS_MM: f64 = 3.0;

/// The point that was clicked, in the substrate marker's frame, mm: the mean over the places.
///
/// # Errors
/// [`LearnError`]: clicks that do not show one point.
pub fn clicked(
    clicks: &[Click],
    places: &BTreeMap<super::Place, Isometry3<f64>>,
    camera: &StereoCamera,
) -> Result<Option<Point3<f64>>, LearnError> {
    let mut points = Vec::new();
    for click in clicks {
        let to_camera = places.get(&click.place).ok_or(LearnError::UnknownPlace(click.place))?;
        let (left, right) = (Vector2::from(click.left), Vector2::from(click.right));
        let apart = |px| LearnError::ClicksApart { place: click.place, px };
        let seen = camera.triangulate(left, right).filter(|p| p.z > 0.0).ok_or(apart(f64::INFINITY))?;
        let back = camera.left.project(&seen).ok_or(apart(f64::INFINITY))?.0;
        let off = 2.0 * (back - left).norm();
        if off > CLICK_PX {
            return Err(apart(off));
        }
        points.push(to_camera.inverse() * seen);
    }
    if points.is_empty() {
        return Ok(None);
    }
    let mean = Point3::from(points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64);
    let mm = points.iter().map(|p| (p - mean).norm()).fold(0.0, f64::max);
    if mm > CLICKS_MM { Err(LearnError::PlacesApart { mm }) } else { Ok(Some(mean)) }
}
