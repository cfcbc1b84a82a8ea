//! Where frames come from, as people write it: `sim`, `exec:COMMAND`, `y4m:FILE`, `folder:DIR`, `v4l:DEVICE`, `stack:DIR`, `curve:FILE`.

use super::camera::{Camera, CameraError};
use super::command::CommandCamera;
use super::recording::Recording;
use super::v4l::options::{NoV4l, V4lOptions};
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;
use thiserror::Error;

/// Where frames come from.
#[derive(Clone, Debug, PartialEq)]
pub enum CameraAddress {
    /// The simulated rig's camera; with options that the simulator reads, as in `sim?fps=100`.
    Simulated(String),
    /// A recorded focal stack: the frame belongs to the axis' height.
    Stack(PathBuf),
    /// A recorded focus curve, `FILE.csv?noise=REL&seed=N`.
    Curve(String),
    /// A program that writes YUV4MPEG2 to its standard output.
    Command(String),
    /// A YUV4MPEG2 file, at its own pace, over and over.
    Y4m(PathBuf),
    /// A folder of pictures, ten a second, over and over.
    Folder(PathBuf),
    /// A camera of Linux' video interface.
    V4l(V4lOptions),
}

/// An address that is none.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum NoCamera {
    /// No such kind.
    #[error(
        "'{0}' is no camera: write sim, exec:COMMAND, v4l:/dev/video0, y4m:FILE, folder:DIR, stack:DIR or curve:FILE.csv (docs/cameras.md has examples)"
    )]
    Unknown(String),
    /// Options that are none.
    #[error(transparent)]
    V4l(#[from] NoV4l),
}

impl FromStr for CameraAddress {
    type Err = NoCamera;

    fn from_str(s: &str) -> Result<Self, NoCamera> {
        let no = || NoCamera::Unknown(s.into());
        if let Some(options) = s.strip_prefix("sim").filter(|rest| rest.is_empty() || rest.starts_with('?')) {
            return Ok(Self::Simulated(options.trim_start_matches('?').into()));
        }
        let (kind, rest) = s.split_once(':').filter(|(_, rest)| !rest.trim().is_empty()).ok_or_else(no)?;
        match kind {
            "stack" => Ok(Self::Stack(rest.into())),
            "curve" => Ok(Self::Curve(rest.into())),
            "exec" => Ok(Self::Command(rest.into())),
            "y4m" => Ok(Self::Y4m(rest.into())),
            "folder" => Ok(Self::Folder(rest.into())),
            "v4l" => Ok(Self::V4l(rest.parse()?)),
            _ => Err(no()),
        }
    }
}

impl fmt::Display for CameraAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Simulated(options) => write!(f, "sim{}{options}", if options.is_empty() { "" } else { "?" }),
            Self::Stack(path) => write!(f, "stack:{}", path.display()),
            Self::Curve(address) => write!(f, "curve:{address}"),
            Self::Command(command) => write!(f, "exec:{command}"),
            Self::Y4m(path) => write!(f, "y4m:{}", path.display()),
            Self::Folder(path) => write!(f, "folder:{}", path.display()),
            Self::V4l(options) => write!(f, "v4l:{options}"),
        }
    }
}

/// Time from the begin of an exposure to the frame's arrival when nobody measured it: longer than that of USB cameras
/// behind a program, so that a frame from before a move never counts as one from after it.
pub const CAREFUL_LATENCY: Duration = Duration::from_millis(150);

impl CameraAddress {
    /// Opens the cameras that deliver frames by themselves; `None` for those that need the rig: `sim`, `stack`, `curve`.
    /// `latency` is the longest time from the begin of an exposure to its frame's arrival; without it frames that carry no
    /// exposure times have none.
    ///
    /// # Errors
    /// [`CameraError`] when it is not there.
    pub fn open(&self, latency: Option<Duration>) -> Result<Option<Box<dyn Camera>>, CameraError> {
        Ok(match self {
            Self::Command(command) => Some(Box::new(CommandCamera::start(command, latency)?)),
            Self::Y4m(path) => Some(Box::new(Recording::y4m(path)?)),
            Self::Folder(path) => Some(Box::new(Recording::folder(path)?)),
            Self::V4l(options) => Some(v4l(options, latency)?),
            Self::Simulated(_) | Self::Stack(_) | Self::Curve(_) => None,
        })
    }
}

#[cfg(all(feature = "v4l", target_os = "linux"))]
fn v4l(options: &V4lOptions, latency: Option<Duration>) -> Result<Box<dyn Camera>, CameraError> {
    Ok(Box::new(super::v4l::V4lCamera::open(options, latency)?))
}

#[cfg(not(all(feature = "v4l", target_os = "linux")))]
fn v4l(options: &V4lOptions, _: Option<Duration>) -> Result<Box<dyn Camera>, CameraError> {
    let reason = "this program was built without V4L2: build it on Linux with `--features v4l` (docs/cameras.md), or use exec:ffmpeg …";
    Err(CameraError::Unopened { camera: options.device.display().to_string(), reason: reason.into() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_read_as_they_are_written() {
        for text in [
            "sim",
            "sim?fps=30&delay_ms=2..5",
            "stack:a/b",
            "curve:c.csv?noise=0.1&seed=2",
            "exec:ffmpeg -i x:y -",
            "y4m:a.y4m",
            "folder:f",
            "v4l:/dev/video0?rate=30",
        ] {
            assert_eq!(text.parse::<CameraAddress>().unwrap().to_string(), text);
        }
        for text in ["", "sim:1", "exec:", "exec: ", "y4m:", "usb:0", "/dev/video0"] {
            assert!(text.parse::<CameraAddress>().is_err_and(|e| e.to_string().contains("exec:COMMAND")), "{text}");
        }
        assert!("v4l:/dev/video0?fps=3".parse::<CameraAddress>().unwrap_err().to_string().contains("'fps=3'"));
    }
}
