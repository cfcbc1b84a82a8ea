//! `--camera` and `--roi`: where pictures come from, and which part of them matters.

use super::simulated;
use anyhow::Context;
use parfocal::autofocus::Span;
use parfocal::autofocus::recorded::{CurveSource, StackSource};
use parfocal::autofocus::source::FocusSource;
use parfocal::focus::Measure;
use parfocal::focus::region::sharpest_tile;
use parfocal::frames::address;
use parfocal::frames::camera::Camera;
use parfocal::frames::curve::Curve;
use parfocal::frames::stack::Stack;
use parfocal::link::transport::later;
use parfocal::picture::{Roi, View};
use parfocal_protocol::units::{HostTime, Micrometres};
use parfocal_simulator::camera::CameraTiming;
use std::path::PathBuf;
use std::str::FromStr;

/// Where frames come from.
#[derive(Clone, Debug)]
pub enum CameraAddress {
    /// The simulated rig's camera.
    Simulated(CameraTiming),
    /// A recorded stack.
    Stack(PathBuf),
    /// A curve, with its options.
    Curve(String),
    /// A camera that delivers by itself: a program's output, a recording.
    Live(address::CameraAddress),
}

impl FromStr for CameraAddress {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let address: address::CameraAddress = s.parse().map_err(|e: address::NoCamera| e.to_string())?;
        Ok(match address {
            address::CameraAddress::Simulated(options) => Self::Simulated(timing(&options)?),
            address::CameraAddress::Stack(path) => Self::Stack(path),
            address::CameraAddress::Curve(address) => Self::Curve(address),
            live => Self::Live(live),
        })
    }
}

/// The timing of the simulated camera, if it is named with one.
///
/// # Errors
/// An option that is none.
pub fn simulated_timing(address: Option<&address::CameraAddress>) -> anyhow::Result<Option<CameraTiming>> {
    match address {
        Some(address::CameraAddress::Simulated(options)) => timing(options).map(Some).map_err(anyhow::Error::msg),
        _ => Ok(None),
    }
}

/// Reads `fps=30&exposure_ms=5&delay_ms=20..150&stamps=arrival`: the simulated camera's timing.
fn timing(options: &str) -> Result<CameraTiming, String> {
    let mut timing = CameraTiming::default();
    for option in options.split('&').filter(|o| !o.is_empty()) {
        let wrong = || {
            format!(
                "'{option}' is no option of the simulated camera: write sim?fps=30&exposure_ms=5&delay_ms=20..150&stamps=arrival"
            )
        };
        let (key, value) = option.split_once('=').ok_or_else(wrong)?;
        let number = |text: &str, low: f64, high: f64| {
            text.parse::<f64>().ok().filter(|v| *v >= low && *v <= high).ok_or_else(wrong)
        };
        let us = |ms: f64| (ms * 1000.0).round() as u64;
        match key {
            "fps" => timing.period_us = (1e6 / number(value, 1.0, 1000.0)?).round() as u64,
            "exposure_ms" => timing.exposure_us = us(number(value, 0.01, 1000.0)?),
            "delay_ms" => {
                let (low, high) = value.split_once("..").unwrap_or((value, value));
                let (low, high) = (us(number(low, 0.0, 1000.0)?), us(number(high, 0.0, 1000.0)?));
                timing.latency_us = low;
                timing.jitter_us = high.checked_sub(low).ok_or_else(wrong)?;
            }
            "stamps" => {
                timing.timestamps = match value {
                    "exposure" => true,
                    "arrival" => false,
                    _ => return Err(wrong()),
                }
            }
            _ => return Err(wrong()),
        }
    }
    if timing.exposure_us > timing.period_us {
        return Err("an exposure cannot be longer than the time between frames".into());
    }
    Ok(timing)
}

/// Which part of the picture matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Region {
    /// All of it.
    All,
    /// The tile with the sharpest texture where the scan begins.
    Sharpest,
    /// What a person drew.
    Drawn(Roi),
}

impl FromStr for Region {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        match s {
            "all" => Ok(Self::All),
            "auto" => Ok(Self::Sharpest),
            _ => s.parse().map(Self::Drawn).map_err(|e: parfocal::picture::PictureError| e.to_string()),
        }
    }
}

/// Side of the tiles among which the sharpest is chosen, px.
const TILE: usize = 64;

/// The sharpest tile of a picture, said on stderr; all of it where nothing rises above noise.
pub fn sharpest(view: View<'_>) -> Option<Roi> {
    let tile = sharpest_tile(view, TILE);
    match tile {
        Some(roi) => eprintln!("region {roi}: the sharpest texture where the scan begins (--roi chooses another)"),
        None => eprintln!("no part of the picture where the scan begins has texture: the whole of it counts"),
    }
    tile
}

/// The sharpest tile of a camera's next frame.
///
/// # Errors
/// The camera.
pub fn sharpest_of(camera: &mut dyn Camera, now: HostTime) -> anyhow::Result<Option<Roi>> {
    let frame = camera.next_frame(later(now, 2_000))?.context("the camera gave no frame to choose a region in")?;
    Ok(sharpest(frame.picture.view()))
}

/// A region of the simulated rig's picture: drawn, or around the tip as a person would draw it.
pub fn simulated_region(rig: &simulated::Handle, region: Option<Region>) -> anyhow::Result<Option<Roi>> {
    match region {
        Some(Region::All) => Ok(None),
        Some(Region::Drawn(roi)) => Ok(Some(roi)),
        None if rig.tip_region().is_some() => {
            let roi = rig.tip_region();
            if let Some(roi) = roi {
                eprintln!("region {roi}: around the simulated pipette's tip, as a person would draw it");
            }
            Ok(roi)
        }
        None | Some(Region::Sharpest) => {
            let now = HostTime(rig.lock().now());
            sharpest_of(&mut rig.camera(), now)
        }
    }
}

/// A recorded source and the heights it covers.
pub struct Recorded {
    /// Its values.
    pub source: Box<dyn FocusSource>,
    /// The heights it covers.
    pub extent: Span,
    /// Distance between its planes, if it has any.
    pub step: Option<Micrometres>,
}

impl Recorded {
    /// Opens a recording; `None` for a live camera. A region is chosen where the scan begins: at `start`, or in the middle.
    ///
    /// # Errors
    /// What is wrong with the file or the region.
    pub fn open(
        address: Option<&CameraAddress>,
        region: Option<Region>,
        measure: Measure,
        start: Option<Micrometres>,
    ) -> anyhow::Result<Option<Self>> {
        match address {
            None | Some(CameraAddress::Simulated(_) | CameraAddress::Live(_)) => Ok(None),
            Some(CameraAddress::Stack(path)) => {
                let stack = Stack::open(path)?;
                if let Some(note) = stack.note {
                    eprintln!("{}: {note}", path.display());
                }
                let (low, high) = stack.extent();
                let begin = start.unwrap_or(Micrometres((low.0 + high.0) / 2.0));
                let roi = match region {
                    Some(Region::Drawn(roi)) => Some(roi),
                    Some(Region::All) => None,
                    // What was recorded, somebody chose: its own region, or all of it.
                    None => stack.roi(),
                    Some(Region::Sharpest) => sharpest(stack.planes[stack.nearest(begin)].view()),
                };
                let step = Some(Micrometres(stack.about.z_step_um));
                let source = StackSource::new(stack, roi, measure).with_context(|| path.display().to_string())?;
                Ok(Some(Self { source: Box::new(source), extent: Span { low, high }, step }))
            }
            Some(CameraAddress::Curve(address)) => {
                let curve = Curve::open(address)?;
                let (low, high) = curve.extent();
                Ok(Some(Self { source: Box::new(CurveSource(curve)), extent: Span { low, high }, step: None }))
            }
        }
    }

    /// The middle of its heights.
    pub fn middle(&self) -> Micrometres {
        Micrometres((self.extent.low.0 + self.extent.high.0) / 2.0)
    }
}
