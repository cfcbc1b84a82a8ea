//! Calibration with nobody at the microscope: the camera from a tip that stays, then every manipulator from its tip at
//! random places, focused and found each time, until the map is known as well as was asked.
//!
//! What a picture shows is believed when two fresh frames agree on it, and what a map is made of when the robust solver
//! counts it in: a detector may be wrong now and then, in either way. Every sample is on the disk before the next move,
//! and a run that is begun again goes on from there. Moves go through [`crate::procedure::Guard`]; no place is chosen
//! below a configured floor.

mod all;
mod bring;
mod camera;
mod error;
mod eyes;
mod gaze;
mod manipulator;
mod places;
mod recalibrate;
mod recognise;
mod records;
mod shank;

pub use all::{Calibrated, Plan, Work, calibrate};
pub use bring::Turret;
pub use error::AutoError;
pub use eyes::{DetectorEyes, Eyes};
pub use recalibrate::{Recalibrated, recalibrate};
