//! Parfocal's host library: it measures focus in camera frames and streams it to the board, calibrates camera and
//! manipulators, and finds pipette tips. The command `parfocal` is built on it.

pub mod autofocus;
pub mod autonomous;
pub mod calibration;
pub mod clock;
pub mod focus;
pub mod frames;
pub mod link;
pub mod page;
pub mod picture;
pub mod procedure;
pub mod rig;
pub mod settings;
pub mod stage;
pub mod tip;
