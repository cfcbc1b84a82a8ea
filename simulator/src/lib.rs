//! A virtual rig: boards that run the very firmware, stages with play and lag, optics fitted to a real tip, a camera with
//! exposure and latency. It lives in virtual time: every run repeats bit for bit.

pub mod board;
pub mod camera;
pub mod hardware;
pub mod mechanics;
pub mod model;
pub mod rig;
pub mod scene;
pub mod stereo;
pub mod strategies;
