//! A V4L2 device, opened and agreed with on what it delivers; through the crate `v4l`.

use super::exposure::Shutter;
use super::options::V4lOptions;
use super::raw::{Layout, RawFormat};
use std::io;
use thiserror::Error;
use v4l::buffer::Type;
use v4l::control::Value;
use v4l::framesize::FrameSizeEnum;
use v4l::prelude::{Device, MmapStream};
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Format, FourCC};

/// Buffers that the device fills in turn.
const BUFFERS: u32 = 4;
/// Controls (linux/v4l2-controls.h): whether the device sets its exposure by itself, and the exposure in 100 µs.
const EXPOSURE_AUTO: u32 = 0x009a_0901;
const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;
/// Values of the former at which the latter holds: manual, and shutter priority.
const SET: [i64; 2] = [1, 2];
/// Between frames when the device does not say, µs.
const PERIOD_US: u64 = 33_333;

/// Why a device is no camera for us.
#[derive(Debug, Error)]
pub enum V4lError {
    /// No such device.
    #[error("there is no such device: plug it in, and see `ls /dev/video*` or `v4l2-ctl --list-devices`")]
    Missing,
    /// Not for this user.
    #[error("this user may not open it: join the group 'video' (`sudo usermod -aG video $USER`) and log in again")]
    NotPermitted,
    /// No device that delivers pictures.
    #[error("it delivers no pictures: many cameras have a second device beside theirs, try the one before or after it")]
    NotACamera,
    /// Somebody else has it.
    #[error("another program uses it: end that one (`fuser -v` with the device's name tells which)")]
    Busy,
    /// Not in a format that can be read.
    #[error("it does not offer {wanted}; it offers {offered}")]
    Format {
        /// What was asked.
        wanted: String,
        /// Its formats.
        offered: String,
    },
    /// Not of this size.
    #[error("it does not offer {width}x{height} in {formats}; sizes it offers: {offered}")]
    Size {
        /// Columns asked.
        width: u32,
        /// Rows asked.
        height: u32,
        /// Formats that were tried.
        formats: String,
        /// Its sizes.
        offered: String,
    },
    /// What else the system says.
    #[error("{what}: {source}")]
    System {
        /// During what.
        what: &'static str,
        /// What the system says.
        source: io::Error,
    },
}

/// What the system says, as what it means.
fn told(what: &'static str) -> impl Fn(io::Error) -> V4lError {
    move |source| match source.kind() {
        io::ErrorKind::NotFound => V4lError::Missing,
        io::ErrorKind::PermissionDenied => V4lError::NotPermitted,
        io::ErrorKind::ResourceBusy => V4lError::Busy,
        _ => match source.raw_os_error().map(rustix::io::Errno::from_raw_os_error) {
            Some(rustix::io::Errno::NODEV | rustix::io::Errno::NXIO) => V4lError::Missing,
            Some(rustix::io::Errno::NOTTY) => V4lError::NotACamera,
            _ => V4lError::System { what, source },
        },
    }
}

/// A device that is ready to deliver.
pub struct Opened {
    /// Its buffers.
    pub stream: MmapStream<'static>,
    /// What is in them.
    pub layout: Layout,
    /// How long its frames take.
    pub shutter: Shutter,
}

/// Opens a device.
///
/// # Errors
/// [`V4lError`].
pub fn open(options: &V4lOptions) -> Result<Opened, V4lError> {
    let device = Device::with_path(&options.device).map_err(told("it cannot be opened"))?;
    device.query_caps().map_err(told("it does not say what it is"))?;
    let layout = agree(&device, options)?;
    if let Some(rate) = options.rate_hz {
        Capture::set_params(&device, &Parameters::with_fps(rate)).map_err(told("it does not take the frame rate"))?;
    }
    let period_us = period_us(&device);
    let us = |ms: f64| (ms * 1000.0).round() as u64;
    let shutter = Shutter {
        exposure_us: options.exposure_ms.map(us).or_else(|| exposure_us(&device)).unwrap_or(period_us),
        readout_us: options.readout_ms.map_or(period_us, us),
    };
    let stream = MmapStream::with_buffers(&device, Type::VideoCapture, BUFFERS);
    Ok(Opened { stream: stream.map_err(told("it gives no buffers"))?, layout, shutter })
}

/// Agrees on format and size.
fn agree(device: &Device, options: &V4lOptions) -> Result<Layout, V4lError> {
    let offered = Capture::enum_formats(device).map_err(|_| V4lError::NotACamera)?;
    if offered.is_empty() {
        return Err(V4lError::NotACamera);
    }
    let wanted = options.format.map_or(RawFormat::ALL.to_vec(), |format| vec![format]);
    let fourcc = |format: RawFormat| FourCC::new(&format.fourcc());
    let names = |formats: &[RawFormat]| formats.iter().map(RawFormat::to_string).collect::<Vec<_>>().join(", ");
    let usable: Vec<_> = wanted.iter().copied().filter(|f| offered.iter().any(|o| o.fourcc == fourcc(*f))).collect();
    if usable.is_empty() {
        let offered = offered.iter().map(|o| format!("{} ({})", o.fourcc, o.description)).collect::<Vec<_>>();
        return Err(V4lError::Format { wanted: names(&wanted), offered: offered.join(", ") });
    }
    let now = Capture::format(device).map_err(told("it does not say its format"))?;
    let (width, height) = options.size.unwrap_or((now.width, now.height));
    for format in &usable {
        let asked = Format::new(width, height, fourcc(*format));
        let got = Capture::set_format(device, &asked).map_err(told("it does not take the format"))?;
        // A device answers with what comes nearest.
        if got.fourcc == asked.fourcc && (got.width, got.height) == (width, height) {
            let (width, height, stride) = (width as usize, height as usize, got.stride as usize);
            return Ok(Layout { format: *format, width, height, stride });
        }
    }
    let mut sizes: Vec<String> = usable.iter().flat_map(|format| sizes(device, fourcc(*format))).collect();
    sizes.dedup();
    Err(V4lError::Size { width, height, formats: names(&usable), offered: sizes.join(", ") })
}

fn sizes(device: &Device, fourcc: FourCC) -> Vec<String> {
    let size = |size: FrameSizeEnum| match size {
        FrameSizeEnum::Discrete(one) => format!("{}x{}", one.width, one.height),
        FrameSizeEnum::Stepwise(all) => {
            format!("{}x{} to {}x{}", all.min_width, all.min_height, all.max_width, all.max_height)
        }
    };
    let all = Capture::enum_framesizes(device, fourcc).unwrap_or_default();
    all.into_iter().map(|entry| size(entry.size)).collect()
}

/// Time between frames, as far as the device tells.
fn period_us(device: &Device) -> u64 {
    let Ok(parameters) = Capture::params(device) else { return PERIOD_US };
    let v4l::Fraction { numerator, denominator } = parameters.interval;
    let us = u64::from(numerator) * 1_000_000 / u64::from(denominator.max(1));
    if us == 0 { PERIOD_US } else { us }
}

/// The exposure, when it is fixed and the device tells it.
fn exposure_us(device: &Device) -> Option<u64> {
    let value = |id| match device.control(id).ok()?.value {
        Value::Integer(value) => Some(value),
        _ => None,
    };
    let fixed = value(EXPOSURE_AUTO).is_some_and(|auto| SET.contains(&auto));
    fixed.then(|| value(EXPOSURE_ABSOLUTE)).flatten().and_then(|v| u64::try_from(v).ok()).map(|v| v * 100)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(device: &str) -> V4lError {
        match open(&device.parse().unwrap()) {
            Ok(_) => panic!("{device} is a camera"),
            Err(error) => error,
        }
    }

    #[test]
    fn what_is_no_camera_is_told() {
        assert!(matches!(refusal("/dev/no-such-camera"), V4lError::Missing));
        assert!(matches!(refusal("/dev/null"), V4lError::NotACamera));
    }

    #[test]
    fn a_camera_that_is_in_use_is_told() {
        let busy = rustix::io::Errno::BUSY.raw_os_error();
        assert!(matches!(told("x")(io::Error::from_raw_os_error(busy)), V4lError::Busy));
        let gone = rustix::io::Errno::NODEV.raw_os_error();
        assert!(matches!(told("x")(io::Error::from_raw_os_error(gone)), V4lError::Missing));
    }
}
