//! A virtual rig.

pub mod stereo;
