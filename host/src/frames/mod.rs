//! Where camera frames come from.

pub mod camera;
pub mod curve;
pub mod image_file;
pub mod pacing;
pub mod stack;
