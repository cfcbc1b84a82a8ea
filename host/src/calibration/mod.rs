//! From pixels to every manipulator: frames of reference, robust solvers, registration.

pub mod chain;
pub mod frames;
pub mod robust;
