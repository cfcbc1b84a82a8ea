//! A virtual rig.

pub mod scene;
pub mod stereo;
