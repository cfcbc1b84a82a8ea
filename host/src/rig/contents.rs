//! What `rig.toml` holds, key by key. Lengths are µm and angles degrees, as the keys' names say.

use super::certainty::Certainty;
use super::markers::{CoarseRegistration, Markers};
use super::names::{BoardId, Coordinate, Device, ManipulatorNumber};
use crate::calibration::coarse::StereoCamera;
use crate::frames::pacing::{Edge, Latency};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The schema this program writes. A file with a higher one is refused, a lower one is read.
pub const SCHEMA: u32 = 1;

/// Three lengths in µm: x, y, z.
pub type Um3 = [f64; 3];

/// The whole file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Contents {
    /// Version of these keys.
    pub schema: u32,
    /// What people call this rig.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The objective in the light path now; a key of `objectives`. What could break a pipette refuses while it is unset.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub objective_in_use: Option<String>,
    /// The microscope's zoom now (its own magnification changer); 1 where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zoom_in_use: Option<f64>,
    /// Controller boards by a name of the person's choice.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub boards: BTreeMap<String, Board>,
    /// Which board and axis index is what: `scope.x`, `m1.z`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub axes: BTreeMap<Device, BTreeMap<Coordinate, Axis>>,
    /// The camera and its calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<Camera>,
    /// Objectives by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub objectives: BTreeMap<String, Objective>,
    /// How much higher all objectives stand than when they were calibrated: turns of the coarse focus knob, which no motor knows of.
    /// It counts in every objective's κ.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub objective_height_um: f64,
    /// Manipulators `m1`, `m2`, …
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub manipulators: BTreeMap<ManipulatorNumber, Manipulator>,
    /// The printed markers on the rig's bodies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub markers: Option<Markers>,
    /// The stereo camera that sees them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stereo: Option<StereoCamera>,
    /// What tips must not run into.
    #[serde(default, rename = "obstacle", skip_serializing_if = "Vec::is_empty")]
    pub obstacles: Vec<Obstacle>,
}

/// A controller board.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Board {
    /// Its unique id, which it tells at the hello; ports change, this does not.
    pub unique_id: BoardId,
}

/// One axis of the rig.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// A key of `boards`.
    pub board: String,
    /// The axis index on that board, from 0.
    pub index: u8,
    /// What a microscope's axis moves; manipulators' axes leave it out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moves: Option<Moves>,
}

/// What an axis of the microscope moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Moves {
    /// The objective with the camera: counts in P_M.
    Objective,
    /// The sample under it: leaves the tips where they are.
    Stage,
}

/// The camera: its sensor, what of it is read, and the picture's matrix.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Columns of the full sensor, unbinned.
    pub width_px: u32,
    /// Rows of the full sensor, unbinned.
    pub height_px: u32,
    /// Part of the sensor that frames show, in unbinned pixels: left, top, width, height. All of it if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop_px: Option<[u32; 4]>,
    /// Sensor pixels to a side of a frame's pixel.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub binning: u32,
    /// A, once measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CameraCalibration>,
    /// How late its frames come, once measured; needed when it does not tell when it exposes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latency: Option<CameraLatency>,
}

/// How late a camera's frames come, by sweeps in both directions at two speeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraLatency {
    /// From the middle of an exposure to the arrival at `edge`.
    pub latency_ms: f64,
    /// Standard error of it.
    pub error_ms: f64,
    /// Time between frames when it was measured; at another rate it does not hold.
    pub period_ms: f64,
    /// earliest or latest: the arrivals that keep the camera's pace best.
    pub edge: Edge,
    /// RFC 3339.
    pub date: String,
}

impl CameraLatency {
    /// As autofocus uses it.
    pub fn in_force(&self) -> Latency {
        Latency { late_us: self.latency_ms * 1000.0, period_us: self.period_ms * 1000.0, edge: self.edge }
    }
}

fn is_zero(v: &f64) -> bool {
    *v == 0.0
}

fn one() -> u32 {
    1
}

fn is_one(n: &u32) -> bool {
    *n == 1
}

/// The 2x2 block A of `T_image_mic*`, for the default objective.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraCalibration {
    /// Row-major; columns are what a pixel to the right and a pixel down are in the microscope's µm.
    pub matrix_um_per_px: [[f64; 2]; 2],
    /// The objective it was measured with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub objective: Option<String>,
    /// How it was found.
    pub record: Record,
}

/// An objective: α and κ for each zoom.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Objective {
    /// True for the one that defines α = 1, κ = 0.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub default: bool,
    /// Depth of field: what autofocus counts its probes in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth_of_field_um: Option<f64>,
    /// One entry for each zoom.
    #[serde(default, rename = "zoom", skip_serializing_if = "Vec::is_empty")]
    pub zooms: Vec<Zoom>,
}

/// α and κ of an objective at one zoom.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Zoom {
    /// The microscope's magnification changer, 1 for none.
    pub zoom: f64,
    /// Size of this objective's pixel in default pixels.
    pub alpha: f64,
    /// Where this objective looks, from where the default one does.
    pub kappa_um: Um3,
    /// How they were found; none if typed in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub record: Option<Record>,
}

/// A manipulator and its pipette.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manipulator {
    /// `T_man_ref`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub registration: Option<Registration>,
    /// `T_man_ref` by printed markers, good to a fraction of a millimetre.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coarse: Option<CoarseRegistration>,
    /// The pipette's direction in ref.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pipette: Option<Pipette>,
    /// Where this pipette's tip is, from where the registered one was (in ref); the newest last. Empty: no change since.
    #[serde(default, rename = "tip_offset", skip_serializing_if = "Vec::is_empty")]
    pub tip_offsets: Vec<TipOffset>,
}

/// A manipulator's map to ref.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Registration {
    /// affine, similarity or rigid.
    pub model: String,
    /// `T_man_ref`, row-major.
    pub matrix: [[f64; 4]; 4],
    /// How it was found.
    pub record: Record,
}

/// Descent Θ and azimuth ψ of a pipette in ref, z up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pipette {
    /// Θ: how steeply an advance goes down.
    pub descent_deg: f64,
    /// ψ: where an advance goes, from x towards y.
    pub azimuth_deg: f64,
    /// protractor, shank, axis or markers.
    pub source: String,
    /// RFC 3339.
    pub date: String,
}

/// A pipette's tip, measured anew after a change of pipette.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TipOffset {
    /// RFC 3339.
    pub date: String,
    /// In ref.
    pub offset_um: Um3,
}

/// How a calibration was found, so that it can be judged and repeated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// RFC 3339.
    pub date: String,
    /// Of the solver and, in live procedures, of the moves.
    pub seed: u64,
    /// The file of samples.
    pub samples: String,
    /// Inliers' tolerance.
    pub tolerance_um: f64,
    /// √mean‖r‖² over the inliers.
    pub rms_um: f64,
    /// ‖r‖ of every sample, in the file's order.
    pub residuals_um: Vec<f64>,
    /// Rows of the file that were left out, from 1.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rejected: Vec<usize>,
    /// How well the map is known; none when the samples fit exactly by their number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certainty: Option<Certainty>,
}

/// A place where no tip may be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Obstacle {
    /// A box in ref.
    Box {
        /// What refusals call it.
        name: String,
        /// Its lowest corner.
        min_um: Um3,
        /// Its highest corner.
        max_um: Um3,
    },
    /// Everything behind a plane in ref.
    HalfSpace {
        /// What refusals call it.
        name: String,
        /// A point of the plane.
        point_um: Um3,
        /// Towards where tips may be.
        normal: [f64; 3],
    },
    /// The dish's floor: everything in ref below a height.
    Floor {
        /// What refusals call it.
        name: String,
        /// The lowest z a tip may have.
        z_um: f64,
    },
    /// The objective in use: a cone that moves with the microscope, its axis along z through the picture's centre.
    Cone {
        /// What refusals call it.
        name: String,
        /// The objective it belongs to; a key of `objectives`.
        objective: String,
        /// From the focal plane to the front lens: positive for a lens above it, negative below (inverted).
        working_distance_um: f64,
        /// Radius of the lens's front.
        front_radius_um: f64,
        /// Between the cone's side and its axis.
        half_angle_deg: f64,
    },
}

impl Obstacle {
    /// What refusals call it.
    pub fn name(&self) -> &str {
        match self {
            Self::Box { name, .. }
            | Self::HalfSpace { name, .. }
            | Self::Floor { name, .. }
            | Self::Cone { name, .. } => name,
        }
    }
}
