//! From pixels to every manipulator: frames of reference, robust solvers, registration.

pub mod coarse;
