//! After a change of pipette: one focus, one detection, the new tip's offset.

use super::all::{Plan, Work, live};
use super::error::AutoError;
use super::gaze::{focus_axis, focus_on_one, turn_deg};
use crate::calibration::chain::{Arm, Chain};
use crate::calibration::frames::Transform;
use crate::procedure::{LiveRig, Progress, Seen, Subject};
use crate::rig::{ManipulatorNumber, Rig, TipOffset};
use nalgebra::Vector3;

/// A tip measured anew.
#[derive(Clone, Debug)]
pub struct Recalibrated {
    /// From where the registered tip was, in ref; [`Rig::add_tip_offset`] puts it in force and warns of an unlikely one.
    pub offset: TipOffset,
    /// From where the newest tip was until now, µm.
    pub moved_um: f64,
    /// How sure the detector is.
    pub confidence: f64,
}

/// A tip that points elsewhere than the manipulator's pipettes do by more than this is another's, degrees.
const OTHERS_DEG: f64 = 45.0;

/// Focuses on the new tip, which is in view, and measures where it is. Nothing but the focus moves, and that goes back.
///
/// # Errors
/// [`AutoError`]: no tip is seen, several could be it, the focus is refused; the manipulator or camera is not calibrated.
pub fn recalibrate(
    work: &mut Work<'_>,
    rig: &Rig,
    manipulator: ManipulatorNumber,
    plan: &Plan,
    date: String,
) -> Result<Recalibrated, AutoError> {
    let chain = Chain::of(rig)?;
    let arm = Arm::of(rig, manipulator)?;
    let (mut live, eyes) = live(work, rig)?;
    live.guard.trusted(&[crate::rig::Device::Manipulator(manipulator), crate::rig::Device::Scope])?;
    let start = live.pose()?;
    live.tell(Progress::Begins(format!("Looking at the new tip of {manipulator}.")));
    let joints = start.joints(manipulator);
    let measured = (|| {
        // Where it points, the pipette before it did.
        let seen_from = expected_deg(rig, &chain, manipulator);
        let its = |live: &mut LiveRig<'_>, mut tips: Vec<Seen>| {
            let alike = |deg: f64| seen_from.is_none_or(|from| turn_deg(deg, from) < OTHERS_DEG);
            tips.retain(|tip| tip.found.angle_deg.is_none_or(alike));
            if tips.len() > 1 {
                let seen = tips.len();
                live.tell(Progress::Warning(format!(
                    "{seen} tips could be that of {manipulator}: the surest that can be focused is taken"
                )));
            }
            tips
        };
        let (_, seen) = focus_on_one(&mut live, eyes, plan, &Subject::Tip(manipulator), &its)?;
        Ok::<_, AutoError>((chain.pixel_to_ref(live.microscope()?, seen.pixel), seen.found.confidence))
    })();
    if live.guard.keep_on() {
        live.move_to(&[(focus_axis(), start.axis(focus_axis()))])?;
    }
    let (place, confidence) = measured?;
    let registered = rig
        .contents()
        .manipulators
        .get(&manipulator)
        .and_then(|m| m.registration.as_ref())
        .and_then(|r| Transform::from_rows(&r.matrix))
        .map_or(arm.ref_from_man(), |map| map);
    let offset = (place - registered * joints).coordinates;
    let moved_um = (place - arm.tip(joints)).coordinates.norm();
    Ok(Recalibrated { offset: TipOffset { date, offset_um: offset.into() }, moved_um, confidence })
}

/// Where a manipulator's pipettes point in the picture, degrees.
fn expected_deg(rig: &Rig, chain: &Chain, manipulator: ManipulatorNumber) -> Option<f64> {
    let azimuth = rig.contents().manipulators.get(&manipulator)?.pipette.as_ref()?.azimuth_deg.to_radians();
    let way = crate::calibration::frames::Displacement::new(azimuth.cos(), azimuth.sin(), 0.0);
    let picture = (chain.ref_from_image(Vector3::zeros()).inverse() * way).coordinates;
    Some(picture.y.atan2(picture.x).to_degrees())
}
