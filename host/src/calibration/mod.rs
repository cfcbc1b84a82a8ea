//! From pixels to every manipulator: frames of reference, robust solvers, registration.

pub mod camera;
pub mod chain;
pub mod coarse;
mod error;
pub mod expected;
pub mod frames;
mod geometry;
pub mod objective;
pub mod pipette;
pub mod registration;
pub mod report;
pub mod robust;
pub mod samples;
pub mod statistics;

pub use error::CalibrationError;
