//! What `rig.toml` holds of coarse registration: which marker is on which body, what was learned of each, and where that puts the manipulators.

use super::contents::Um3;
use super::names::ManipulatorNumber;
use crate::calibration::coarse::MarkerId;
use crate::calibration::coarse::learn::Learned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The source of a pipette's direction that the markers show.
pub const MARKERS: &str = "markers";

/// The printed markers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Markers {
    /// Length of the black border's outer edge.
    pub tag_mm: f64,
    /// The marker on the substrate.
    pub substrate: MarkerId,
    /// The marker on the objective.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub objective: Option<MarkerId>,
    /// The marker on each manipulator.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub manipulators: BTreeMap<ManipulatorNumber, MarkerId>,
    /// Where tips, axes and focal point are from the markers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub learned: Option<Learned>,
}

/// A manipulator's map to ref by its marker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoarseRegistration {
    /// `T_man_ref`, row-major, µm.
    pub matrix: [[f64; 4]; 4],
    /// Expected root mean square error of the tip's place.
    pub error_um: f64,
    /// Expected root mean square error of directions.
    pub error_deg: f64,
    /// Where the joints were; the error grows away from there.
    pub joints_um: Um3,
    /// RFC 3339.
    pub date: String,
}

impl Markers {
    /// Whose marker a number is: `None` for the objective's, the substrate's and strange ones.
    pub fn manipulator(&self, id: MarkerId) -> Option<ManipulatorNumber> {
        self.manipulators.iter().find(|(_, marker)| **marker == id).map(|(number, _)| *number)
    }
}
