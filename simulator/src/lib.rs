//! A virtual rig.

pub mod scene;
