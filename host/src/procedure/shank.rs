//! A pipette's direction, live: the focus along its shank. The first place is the tip; each next one lies farther up.

use super::camera::sample;
use super::error::ProcedureError;
use super::live::{LiveRig, Progress};
use super::point::{NotFound, PointFinder, Subject};
use super::record::{Recorder, Sample};
use crate::calibration::chain::{Chain, Pixel};
use crate::rig::{AxisName, Coordinate, Device, ManipulatorNumber};
use parfocal_protocol::units::Micrometres;

/// What to do.
#[derive(Clone, Debug)]
pub struct ShankPlan {
    /// Whose pipette.
    pub manipulator: ManipulatorNumber,
    /// Places along the shank, besides the tip.
    pub places: usize,
    /// From one to the next in the picture, px of the sensor.
    pub step_px: f64,
    /// How far a place's focus may be from the one before, µm.
    pub focus_within_um: f64,
}

/// Records places in focus along the shank; solve them with [`crate::calibration::pipette::from_shank`]. The focus goes
/// back to where it was.
///
/// # Errors
/// [`ProcedureError`]: no chain, the tip is not found, or the shank leaves the picture before three places.
pub fn shank(
    live: &mut LiveRig<'_>,
    finder: &mut dyn PointFinder,
    plan: &ShankPlan,
    recorder: &mut Recorder,
) -> Result<(), ProcedureError> {
    let z = AxisName { device: Device::Scope, coordinate: Coordinate::Z };
    let start = live.pose()?;
    let done = along(live, finder, plan, recorder, z);
    let returned = if live.guard.keep_on() { live.move_to(&[(z, start.axis(z))]) } else { Ok(()) };
    done.and(returned)
}

fn along(
    live: &mut LiveRig<'_>,
    finder: &mut dyn PointFinder,
    plan: &ShankPlan,
    recorder: &mut Recorder,
    z: AxisName,
) -> Result<(), ProcedureError> {
    let chain = Chain::of(live.rig())?;
    let subject = Subject::Tip(plan.manipulator);
    let tip = live.focus_on(finder, &subject, None, plan.focus_within_um)?;
    let angle = match tip.found.angle_deg {
        Some(angle) => angle.to_radians(),
        None => {
            // A person shows where the shank is.
            let shank = live.find(finder, &Subject::Shank(plan.manipulator), None, None)?;
            let (dx, dy) = (tip.pixel.x_px - shank.pixel.x_px, tip.pixel.y_px - shank.pixel.y_px);
            if dx.hypot(dy) < plan.step_px {
                return Err(NotFound::Unseen(Subject::Shank(plan.manipulator)).into());
            }
            dy.atan2(dx)
        }
    };
    for k in 0..=plan.places {
        let back = plan.step_px * k as f64;
        let pixel = Pixel { x_px: tip.pixel.x_px - back * angle.cos(), y_px: tip.pixel.y_px - back * angle.sin() };
        if !live.window().shows(pixel, plan.step_px / 2.0) {
            break;
        }
        // All of them, the tip too, by the peak of the same measure: what it is off by is the same everywhere.
        let here = live.pose()?.axis(z);
        let range = (Micrometres(here.0 - plan.focus_within_um), Micrometres(here.0 + plan.focus_within_um));
        match live.focus(z, pixel, range) {
            Ok(_) => {}
            Err(error) if error.is_local() => {
                live.tell(Progress::Passed(error.to_string()));
                continue;
            }
            Err(error) => return Err(error),
        }
        let pose = live.pose()?;
        let mic_um = pose.microscope(live.rig());
        let place = chain.pixel_to_ref(mic_um, pixel);
        let seen = super::live::Seen { pixel, found: tip.found };
        let kept = Sample { ref_um: Some(place.coordinates), ..sample(live, &subject, &pose, &seen, mic_um) };
        recorder.keep(kept)?;
        live.tell(Progress::Recorded { done: recorder.samples().len(), of: plan.places + 1 });
    }
    let (got, wanted) = (recorder.samples().len(), plan.places + 1);
    if got < 3 {
        let last = "the shank leaves the picture, or is not in focus anywhere".into();
        return Err(ProcedureError::Lost { got, wanted, passed: wanted - got, last });
    }
    Ok(())
}
