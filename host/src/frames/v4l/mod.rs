//! Cameras of Linux' own video interface, V4L2: `v4l:/dev/video0`.
//!
//! [`options`] reads the address, [`raw`] turns buffers into grey pictures, [`exposure`] tells when they were exposed; these are plain
//! functions. The device itself is there with the feature `v4l` on Linux only: its crate needs libclang to be built.

pub mod exposure;
pub mod options;
pub mod raw;

#[cfg(all(feature = "v4l", target_os = "linux"))]
mod device;
#[cfg(all(feature = "v4l", target_os = "linux"))]
mod thread;
#[cfg(all(feature = "v4l", target_os = "linux"))]
pub use thread::V4lCamera;
