//! Which tip in view is a manipulator's own.

use super::all::Plan;
use super::error::AutoError;
use super::eyes::Eyes;
use super::gaze::{Gaze, apart, search_until, steady, turn_deg};
use super::manipulator::FIRST_UM;
use crate::calibration::chain::Chain;
use crate::procedure::{LiveRig, Progress, Seen, Subject, targets};
use crate::rig::{Coordinate, Device, ManipulatorNumber};

/// Which of the tips in view is a manipulator's: the one that moves when it does. Tips of other pipettes may be nearer to focus:
/// it is looked for beyond them, too.
///
/// # Errors
/// No tip is in view, or none or several of them move.
pub fn recognise(
    live: &mut LiveRig<'_>,
    eyes: &mut dyn Eyes,
    chain: &Chain,
    manipulator: ManipulatorNumber,
    plan: &Plan,
) -> Result<(Seen, Gaze), AutoError> {
    let mut most = 0;
    let found = search_until(live, eyes, plan.reach_um, &mut |live, eyes, tips| {
        most = most.max(tips.len());
        mover(live, eyes, chain, manipulator, &tips)
    });
    match found {
        Err(AutoError::NoTip { .. }) if most > 0 => Err(AutoError::NotMoving { manipulator, seen: most }),
        found => found,
    }
}

/// The one of these tips that moves with a manipulator.
fn mover(
    live: &mut LiveRig<'_>,
    eyes: &mut dyn Eyes,
    chain: &Chain,
    manipulator: ManipulatorNumber,
    before: &[Seen],
) -> Result<Option<(Seen, Gaze)>, AutoError> {
    let device = Device::Manipulator(manipulator);
    let Some(surest) = before.first() else { return Ok(None) };
    let start = live.pose()?;
    let place = chain.pixel_to_ref(start.microscope(live.rig()), surest.pixel);
    live.guard.seen(manipulator, place, start.joints(manipulator));
    for coordinate in [Coordinate::Y, Coordinate::X, Coordinate::Z] {
        let mut why = None;
        for step in [FIRST_UM, -FIRST_UM] {
            let mut to = start.device(device);
            to[coordinate.index()] += step;
            match live.move_to(&targets(device, to)) {
                Ok(()) => {}
                Err(error) if error.is_local() => {
                    why = Some(error);
                    continue;
                }
                Err(error) => return Err(error.into()),
            }
            let after = steady(live, eyes)?;
            live.move_to(&targets(device, start.device(device)))?;
            let moved: Vec<&Seen> = before.iter().filter(|tip| has_moved(tip, &after)).collect();
            match moved[..] {
                [] => {}
                [tip] => {
                    let subject = Subject::Tip(manipulator);
                    return Ok(Some((*tip, Gaze { subject, angle_deg: tip.found.angle_deg })));
                }
                _ => return Err(AutoError::SeveralMove { manipulator, seen: moved.len() }),
            }
            why = None;
            break;
        }
        if let Some(error) = why {
            live.tell(Progress::Passed(error.to_string()));
        }
    }
    Ok(None)
}

/// Whether a tip is gone from its place, and one like it is near.
fn has_moved(tip: &Seen, after: &[Seen]) -> bool {
    let alike =
        |other: &Seen| tip.found.angle_deg.zip(other.found.angle_deg).is_none_or(|(a, b)| turn_deg(a, b) < 20.0);
    let off = |other: &Seen| apart(tip.pixel, other.pixel);
    let stayed = after.iter().any(|other| alike(other) && off(other) < STAYED_PX);
    !stayed && after.iter().any(|other| alike(other) && off(other) < MOVED_PX)
}

/// A tip seen within this of its place has stayed, px; one that has moved by [`FIRST_UM`] is within the other.
const STAYED_PX: f64 = 6.0;
const MOVED_PX: f64 = 120.0;
