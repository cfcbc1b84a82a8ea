//! Coarse registration: where manipulators and objective stand, seen by a stereo camera from any two or more places.
//!
//! Every body carries a printed marker. From each place of the stereo camera, each marker's pose relative to the camera follows from its
//! edges in both pictures ([`fit`]); taken relative to the substrate's marker, the camera's place drops out. All views together
//! make a graph of poses, adjusted at once, those that contradict the others left out ([`graph`]).
//!
//! A marker's frame has its origin at the marker's centre, x right and y down with the marker upright, z into the paper. Poses are
//! marker → substrate marker, mm.

mod blur;
pub mod board;
pub mod camera;
pub mod edges;
pub mod fit;
pub mod gamma;
pub mod graph;
pub mod learn;
mod levels;
mod lm;
pub mod marker;
pub mod objective;
pub mod poses;
pub mod register;
mod reject;
pub mod sheet;
mod start;
#[cfg(test)]
mod tests;
mod weighted;

pub use camera::{Lens, Side, StereoCamera, StereoError};
pub use graph::{MarkerPose, Registration};
pub use register::{Pair, Settings, register};
pub use reject::{CoarseError, Rejected, Why};

use serde::{Deserialize, Serialize};

/// A length in millimetres.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Millimetres(pub f64);

/// An angle in degrees.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Degrees(pub f64);

impl std::fmt::Display for Millimetres {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.3} mm", self.0)
    }
}

impl std::fmt::Display for Degrees {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.2}°", self.0)
    }
}

/// A marker's number in the family tag36h11: 0 to 586.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct MarkerId(pub u16);

impl std::fmt::Display for MarkerId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

/// Where the stereo camera stood: the K of `place_K_left.png`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Place(pub u32);

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}
