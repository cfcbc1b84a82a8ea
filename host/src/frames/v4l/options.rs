//! `v4l:/dev/video0?size=1280x960&rate=30&format=GREY&exposure_ms=5&readout_ms=0` as people write it.

use super::raw::RawFormat;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use thiserror::Error;

/// A V4L2 device and how it is to deliver.
#[derive(Clone, Debug, PartialEq)]
pub struct V4lOptions {
    /// The device.
    pub device: PathBuf,
    /// Columns and rows; as the device has them set without.
    pub size: Option<(u32, u32)>,
    /// Frames a second; as the device has it set without.
    pub rate_hz: Option<u32>,
    /// How pixels come; the first that the device offers of [`RawFormat::ALL`] without.
    pub format: Option<RawFormat>,
    /// How long a frame is exposed, ms; what the device says, or else the time between two frames, without.
    pub exposure_ms: Option<f64>,
    /// From the end of the first row's exposure to that of the last row's, ms; the time between two frames, as of a rolling
    /// shutter at its full rate, without. A global shutter has 0.
    pub readout_ms: Option<f64>,
}

/// An address that is none.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "'{0}': write v4l:/dev/video0, with options as in v4l:/dev/video0?size=1280x960&rate=30&format=GREY&exposure_ms=5&readout_ms=0"
)]
pub struct NoV4l(String);

impl FromStr for V4lOptions {
    type Err = NoV4l;

    fn from_str(s: &str) -> Result<Self, NoV4l> {
        let (device, options) = s.split_once('?').unwrap_or((s, ""));
        if device.trim().is_empty() {
            return Err(NoV4l(s.into()));
        }
        let mut read = Self {
            device: device.into(),
            size: None,
            rate_hz: None,
            format: None,
            exposure_ms: None,
            readout_ms: None,
        };
        for option in options.split('&').filter(|option| !option.is_empty()) {
            let wrong = || NoV4l(option.into());
            let (key, value) = option.split_once('=').ok_or_else(wrong)?;
            let whole = |text: &str, most: u32| text.parse().ok().filter(|n| (1..=most).contains(n)).ok_or_else(wrong);
            let time = || value.parse().ok().filter(|ms| (0.0..=10_000.0).contains(ms)).ok_or_else(wrong);
            match key {
                "size" => {
                    let (width, height) = value.split_once('x').ok_or_else(wrong)?;
                    read.size = Some((whole(width, 32_768)?, whole(height, 32_768)?));
                }
                "rate" => read.rate_hz = Some(whole(value, 1000)?),
                "format" => read.format = Some(value.parse().map_err(|()| wrong())?),
                "exposure_ms" => read.exposure_ms = Some(time()?),
                "readout_ms" => read.readout_ms = Some(time()?),
                _ => return Err(wrong()),
            }
        }
        Ok(read)
    }
}

impl fmt::Display for V4lOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let options = [
            self.size.map(|(width, height)| format!("size={width}x{height}")),
            self.rate_hz.map(|rate| format!("rate={rate}")),
            self.format.map(|format| format!("format={format}")),
            self.exposure_ms.map(|ms| format!("exposure_ms={ms}")),
            self.readout_ms.map(|ms| format!("readout_ms={ms}")),
        ];
        let options: Vec<String> = options.into_iter().flatten().collect();
        write!(f, "{}{}{}", self.device.display(), if options.is_empty() { "" } else { "?" }, options.join("&"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_read_as_they_are_written() {
        for text in [
            "/dev/video0",
            "/dev/v4l/by-id/usb-a_b-video-index0?size=1280x960",
            "/dev/video2?size=640x480&rate=30&format=GREY&exposure_ms=2.5&readout_ms=0",
            "/dev/video2?format=MJPG",
        ] {
            assert_eq!(text.parse::<V4lOptions>().unwrap().to_string(), text);
        }
        for text in
            ["", " ", "a?size=640", "a?size=0x4", "a?rate=0", "a?format=H264", "a?exposure_ms=-1", "a?x=1", "a?rate"]
        {
            let said = text.parse::<V4lOptions>().unwrap_err().to_string();
            assert!(said.contains("v4l:/dev/video0"), "{text}: {said}");
        }
    }
}
