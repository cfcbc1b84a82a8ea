//! Where camera frames come from.

pub mod address;
pub mod camera;
pub mod command;
pub mod curve;
pub mod image_file;
pub mod mailbox;
pub mod pacing;
pub mod recording;
pub mod stack;
pub mod v4l;
pub mod y4m;
