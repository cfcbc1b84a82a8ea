//! A calibration with nobody at the microscope, on the simulated rig in virtual time.

mod by_markers;
mod eyes;
mod faults;
mod heights;
mod into_view;
mod recalibrated;
mod rendered;
mod seen;
mod unattended;
#[path = "../live/world.rs"]
#[allow(dead_code, reason = "the live procedures' tests use the rest")]
mod world;
