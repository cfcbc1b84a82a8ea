//! Where frames come from, as people write it: `sim`, `exec:COMMAND`, `y4m:FILE`, `folder:DIR`, `stack:DIR`, `curve:FILE`.

use super::camera::{Camera, CameraError};
use super::command::CommandCamera;
use super::recording::Recording;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;
use thiserror::Error;

/// Where frames come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CameraAddress {
    /// The simulated rig's camera.
    Simulated,
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
}

/// An address that is none.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "'{0}' is no camera: write sim, exec:COMMAND, y4m:FILE, folder:DIR, stack:DIR or curve:FILE.csv (docs/cameras.md has examples)"
)]
pub struct NoCamera(String);

impl FromStr for CameraAddress {
    type Err = NoCamera;

    fn from_str(s: &str) -> Result<Self, NoCamera> {
        let no = || NoCamera(s.into());
        if s == "sim" {
            return Ok(Self::Simulated);
        }
        let (kind, rest) = s.split_once(':').filter(|(_, rest)| !rest.trim().is_empty()).ok_or_else(no)?;
        match kind {
            "stack" => Ok(Self::Stack(rest.into())),
            "curve" => Ok(Self::Curve(rest.into())),
            "exec" => Ok(Self::Command(rest.into())),
            "y4m" => Ok(Self::Y4m(rest.into())),
            "folder" => Ok(Self::Folder(rest.into())),
            _ => Err(no()),
        }
    }
}

impl fmt::Display for CameraAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Simulated => f.write_str("sim"),
            Self::Stack(path) => write!(f, "stack:{}", path.display()),
            Self::Curve(address) => write!(f, "curve:{address}"),
            Self::Command(command) => write!(f, "exec:{command}"),
            Self::Y4m(path) => write!(f, "y4m:{}", path.display()),
            Self::Folder(path) => write!(f, "folder:{}", path.display()),
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
            Self::Simulated | Self::Stack(_) | Self::Curve(_) => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_read_as_they_are_written() {
        for text in
            ["sim", "stack:a/b", "curve:c.csv?noise=0.1&seed=2", "exec:ffmpeg -i x:y -", "y4m:a.y4m", "folder:f"]
        {
            assert_eq!(text.parse::<CameraAddress>().unwrap().to_string(), text);
        }
        for text in ["", "sim:1", "exec:", "exec: ", "y4m:", "usb:0", "/dev/video0"] {
            assert!(text.parse::<CameraAddress>().is_err_and(|e| e.to_string().contains("exec:COMMAND")), "{text}");
        }
    }
}
