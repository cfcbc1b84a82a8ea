//! Using a calibration: where axes have to go so that a tip, or the picture, is where a person pointed. Nothing here
//! moves; [`super::Guard::move_to`] does, after looking.

use super::error::ProcedureError;
use super::guard::{Pose, Targets, moves_sample, targets};
use super::point::Window;
use crate::calibration::chain::{Arm, Chain, ChainError, Pixel};
use crate::calibration::expected;
use crate::calibration::frames::{Point, Ref};
use crate::rig::{AxisName, Coordinate, Device, ManipulatorNumber, Rig};
use parfocal_protocol::units::Micrometres;
use serde::Serialize;

/// Where the microscope's x and y go so that what is seen at `pixel` comes to the middle of the sensor.
///
/// # Errors
/// [`ChainError`], saying what to calibrate.
pub fn microscope_to_pixel(rig: &Rig, pose: &Pose, pixel: Pixel) -> Result<Targets, ProcedureError> {
    let chain = Chain::of(rig)?;
    let position = pose.microscope(rig);
    let sensor = chain.sensor();
    let middle =
        Pixel { x_px: (f64::from(sensor.width_px) - 1.0) / 2.0, y_px: (f64::from(sensor.height_px) - 1.0) / 2.0 };
    let place = chain.pixel_to_ref(position, pixel);
    let by = chain.position_showing(place, middle) - position;
    let shifted = [Coordinate::X, Coordinate::Y].map(|coordinate| {
        let name = AxisName { device: Device::Scope, coordinate };
        // The sample has to come the other way.
        let sign = if moves_sample(rig, name) { -1.0 } else { 1.0 };
        (name, Micrometres(pose.axis(name).0 + sign * by[coordinate.index()]))
    });
    Ok(shifted.into())
}

/// Where a manipulator's joints go so that its tip is in focus at `pixel`, `above` the focal plane. A manipulator that is not
/// registered goes by its marker, if the rig's file has that; [`expected::tip`] says how far off that may be.
///
/// # Errors
/// [`ChainError`], saying what to calibrate.
pub fn tip_to_pixel(
    rig: &Rig,
    pose: &Pose,
    number: ManipulatorNumber,
    pixel: Pixel,
    above: Micrometres,
) -> Result<Targets, ProcedureError> {
    let chain = Chain::of(rig)?;
    let mut place = chain.pixel_to_ref(pose.microscope(rig), pixel);
    place.coordinates.z += above.0;
    tip_to(rig, number, place)
}

/// By its registration, or by its marker alone.
fn arm(rig: &Rig, number: ManipulatorNumber) -> Result<Arm, ChainError> {
    Arm::of(rig, number).or_else(|error| Arm::coarse_of(rig, number).map(|(arm, _)| arm).ok_or(error))
}

/// Where a manipulator's joints go so that its tip is at a place of ref.
///
/// # Errors
/// [`ChainError`], saying what to calibrate.
pub fn tip_to(rig: &Rig, number: ManipulatorNumber, place: Point<Ref>) -> Result<Targets, ProcedureError> {
    if rig.contents().objective_in_use.is_none() {
        return Err(ChainError::NoObjective.into());
    }
    let arm = arm(rig, number)?;
    Ok(targets(Device::Manipulator(number), arm.joints_for(place).coordinates))
}

/// Where a manipulator's joints go so that its tip advances by a distance along the pipette (below 0: withdraws).
///
/// # Errors
/// [`ChainError`], saying what to calibrate.
pub fn coaxial(rig: &Rig, pose: &Pose, number: ManipulatorNumber, by: Micrometres) -> Result<Targets, ProcedureError> {
    if rig.contents().objective_in_use.is_none() {
        return Err(ChainError::NoObjective.into());
    }
    let step = Arm::of(rig, number)?.coaxial(by.0).ok_or(ChainError::NoPipette(number))?;
    Ok(targets(Device::Manipulator(number), (pose.joints(number) + step).coordinates))
}

/// Where a tip is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TipPlace {
    /// Whose.
    pub manipulator: ManipulatorNumber,
    /// In ref, µm; none while the manipulator is not registered.
    pub ref_um: Option<[f64; 3]>,
    /// On the sensor, px; none while the chain is not known.
    pub pixel: Option<[f64; 2]>,
    /// Above the focal plane, µm.
    pub above_focus_um: Option<f64>,
    /// Standard error of its place in each direction, µm, if the calibration tells.
    pub error_um: Option<f64>,
    /// By its marker alone: the manipulator is not registered.
    pub coarse: bool,
    /// Whether frames show it.
    pub in_view: bool,
    /// Why something is not known.
    pub why: Option<String>,
}

/// Where every manipulator's tip is, as far as is known.
pub fn tips(rig: &Rig, pose: &Pose) -> Vec<TipPlace> {
    let contents = rig.contents();
    let of_axes = contents.axes.keys().filter_map(|device| match device {
        Device::Manipulator(n) => Some(*n),
        Device::Scope => None,
    });
    let mut numbers: Vec<ManipulatorNumber> = of_axes.chain(contents.manipulators.keys().copied()).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let chain = Chain::of(rig);
    let window = contents.camera.as_ref().map(Window::of);
    let place = |n: ManipulatorNumber| {
        let unknown = TipPlace {
            manipulator: n,
            ref_um: None,
            pixel: None,
            above_focus_um: None,
            error_um: None,
            coarse: false,
            in_view: false,
            why: None,
        };
        let arm = match arm(rig, n) {
            Ok(arm) => arm,
            Err(why) => return TipPlace { why: Some(why.to_string()), ..unknown },
        };
        let tip = arm.tip(pose.joints(n));
        let error = expected::tip(rig, n, pose.joints(n), pose.microscope(rig));
        let known = TipPlace {
            ref_um: Some(tip.coordinates.into()),
            error_um: error.map(|error| error.0),
            coarse: Arm::of(rig, n).is_err(),
            ..unknown
        };
        match &chain {
            Err(why) => TipPlace { why: Some(why.to_string()), ..known },
            Ok(chain) => {
                let (pixel, above) = chain.ref_to_pixel(pose.microscope(rig), tip);
                TipPlace {
                    pixel: Some([pixel.x_px, pixel.y_px]),
                    above_focus_um: Some(above),
                    in_view: window.is_some_and(|window| window.shows(pixel, 0.0)),
                    ..known
                }
            }
        }
    };
    numbers.into_iter().map(place).collect()
}
