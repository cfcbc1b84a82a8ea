//! Where things are in the picture: known tips, and where a click leads.

use super::desk::Desk;
use crate::calibration::chain::{Arm, Chain, ChainError, Pixel, Sensor};
use crate::calibration::frames::Point;
use crate::rig::{AxisName, Coordinate, Device, ManipulatorNumber, Moves, Rig};
use nalgebra::Vector3;
use parfocal_protocol::units::Micrometres;
use serde::Serialize;
use thiserror::Error;

/// A known tip in the picture.
#[derive(Clone, Debug, Serialize)]
pub struct Tip {
    /// Whose.
    pub name: ManipulatorNumber,
    /// Column in the frame.
    pub x_px: f64,
    /// Row in the frame.
    pub y_px: f64,
    /// Above the focal plane.
    pub height_um: f64,
}

/// Why a click leads nowhere.
#[derive(Debug, Error)]
pub enum NoPlace {
    /// Something is not calibrated.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// A position is not known, or there is no such axis.
    #[error("where {0} is is not known: is its board connected?")]
    NoPosition(Device),
    /// An axis of the microscope moves the stage.
    #[error("clicking moves what moves with the objective; here the stage moves the sample: move {0} by its buttons")]
    Stage(AxisName),
}

/// A device's position, µm, from its three axes; an axis that is not there counts 0.
pub fn position(desk: &Desk, device: Device) -> Option<Vector3<f64>> {
    let mut at = Vector3::zeros();
    let mut any = false;
    for axis in desk.axes.iter().filter(|axis| axis.name.device == device) {
        at[axis.name.coordinate.index()] = desk.position(axis)?.0.position.micrometres().0;
        any = true;
    }
    any.then_some(at)
}

/// P_M: the microscope's position, counting the axes that move the objective.
pub fn microscope(desk: &Desk, rig: &Rig) -> Option<Vector3<f64>> {
    let mut at = position(desk, Device::Scope)?;
    for coordinate in Coordinate::ALL {
        let name = AxisName { device: Device::Scope, coordinate };
        if rig.axis(name).is_some_and(|axis| axis.moves == Some(Moves::Stage)) {
            at[coordinate.index()] = 0.0;
        }
    }
    Some(at)
}

/// What of the sensor frames show.
fn crop(rig: &Rig) -> (Option<[u32; 4]>, u32) {
    rig.contents().camera.as_ref().map_or((None, 1), |camera| (camera.crop_px, camera.binning))
}

/// Every registered tip where it shows in the frame.
pub fn tips(desk: &Desk, rig: &Rig) -> Vec<Tip> {
    let (Ok(chain), Some(at)) = (Chain::of(rig), microscope(desk, rig)) else { return Vec::new() };
    let (crop, binning) = crop(rig);
    let [left, top, ..] = crop.unwrap_or_default();
    let frame = |px: f64, start: u32| (px - f64::from(start) + 0.5) / f64::from(binning) - 0.5;
    let tip = |number: ManipulatorNumber| {
        let arm = Arm::of(rig, number).ok()?;
        let joints = position(desk, Device::Manipulator(number))?;
        let (pixel, height_um) = chain.ref_to_pixel(at, arm.tip(joints.into()));
        Some(Tip { name: number, x_px: frame(pixel.x_px, left), y_px: frame(pixel.y_px, top), height_um })
    };
    rig.contents().manipulators.keys().filter_map(|number| tip(*number)).collect()
}

/// A frame's pixel on the sensor.
pub fn sensor_pixel(rig: &Rig, frame: Pixel) -> Pixel {
    let (crop, binning) = crop(rig);
    Sensor::from_frame(frame.x_px, frame.y_px, crop, binning)
}

/// Where a device's axes have to go so that a click comes true: the microscope brings the clicked place to the picture's
/// centre, a manipulator its tip to the clicked place, at the height that is in focus.
///
/// # Errors
/// [`NoPlace`].
pub fn targets(desk: &Desk, device: Device, click: Pixel) -> Result<Vec<(AxisName, Micrometres)>, NoPlace> {
    let rig = desk.rig();
    let chain = Chain::of(&rig)?;
    let at = microscope(desk, &rig).ok_or(NoPlace::NoPosition(Device::Scope))?;
    let place: Point<_> = chain.pixel_to_ref(at, sensor_pixel(&rig, click));
    let (to, coordinates) = match device {
        Device::Scope => {
            let centre = chain.sensor().to_pixel(Point::new(0.0, 0.0, 0.0));
            (chain.position_showing(place, centre), &Coordinate::ALL[..2])
        }
        Device::Manipulator(number) => (Arm::of(&rig, number)?.joints_for(place).coordinates, &Coordinate::ALL[..]),
    };
    let mut targets = Vec::new();
    for coordinate in coordinates {
        let name = AxisName { device, coordinate: *coordinate };
        if rig.axis(name).is_some_and(|axis| axis.moves == Some(Moves::Stage)) {
            return Err(NoPlace::Stage(name));
        }
        if desk.axis(name).is_none() {
            return Err(NoPlace::NoPosition(device));
        }
        targets.push((name, Micrometres(to[coordinate.index()])));
    }
    Ok(targets)
}
