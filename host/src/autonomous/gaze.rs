//! Looking at one tip until two frames agree on where it is.

use super::all::Plan;
use super::camera::ASTRAY_SHARE;
use super::error::AutoError;
use super::eyes::Eyes;
use crate::calibration::chain::Pixel;
use crate::procedure::{LiveRig, NotFound, Progress, Seen, Subject};
use crate::rig::{AxisName, Coordinate, Device};
use parfocal_protocol::units::Micrometres;

/// A tip, and how to tell it from others.
#[derive(Clone, Debug)]
pub struct Gaze {
    /// What is looked at.
    pub subject: Subject,
    /// Direction in which it points, degrees; `None`: not known yet.
    pub angle_deg: Option<f64>,
}

/// Where a tip should be, and how far from there it may be.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// Where.
    pub pixel: Pixel,
    /// How far off, px of the sensor.
    pub within_px: f64,
}

/// Frames that are looked at before they count as disagreeing.
const LOOKS: usize = 6;
/// Frames without a tip after which there is none.
const EMPTY: usize = 2;
/// Sightings in two frames agree within this, px; more for a blurred tip.
const AGREE_PX: f64 = 3.0;
const AGREE_BLURRED_PX: f64 = 8.0;
/// A tip of another pipette points elsewhere by more than this, degrees.
const TURN_DEG: f64 = 30.0;
/// Full scale's share below which a whole picture is dark.
const DARK: f64 = 0.02;
/// Steps in which tips are looked for in depth: a detector sees them within 10 µm of focus.
const DEPTH_STEP_UM: f64 = 12.0;

/// The microscope's focus.
pub fn focus_axis() -> AxisName {
    AxisName { device: Device::Scope, coordinate: Coordinate::Z }
}

/// Distance of two pixels.
pub fn apart(a: Pixel, b: Pixel) -> f64 {
    (a.x_px - b.x_px).hypot(a.y_px - b.y_px)
}

/// Angle between two directions, degrees, 0 to 180.
pub fn turn_deg(a: f64, b: f64) -> f64 {
    let d = (a - b).rem_euclid(360.0);
    d.min(360.0 - d)
}

/// Tips in one fresh frame, on the sensor.
fn seen(live: &mut LiveRig<'_>, eyes: &mut dyn Eyes) -> Result<Vec<Seen>, AutoError> {
    let frame = live.fresh_frame()?;
    let tips = eyes.tips(&frame);
    if tips.is_empty() {
        let view = frame.picture.view();
        let scale = f64::from(if view.bits() == 8 { u32::from(u8::MAX) } else { u32::from(u16::MAX) });
        // A few pixels are enough to tell night from day.
        let step = (view.width() / 32).max(1);
        let most = (0..view.height())
            .step_by(step)
            .flat_map(|y| (0..view.width()).step_by(step).filter_map(move |x| view.get(x, y)))
            .max();
        if most.is_some_and(|most| f64::from(most) < DARK * scale) {
            return Err(AutoError::Dark);
        }
    }
    let window = live.window();
    Ok(tips.into_iter().map(|found| Seen { pixel: window.to_sensor(found.at), found }).collect())
}

/// All tips that two fresh frames agree on, the surest first.
pub fn steady(live: &mut LiveRig<'_>, eyes: &mut dyn Eyes) -> Result<Vec<Seen>, AutoError> {
    let mut frames: Vec<Vec<Seen>> = Vec::new();
    for _ in 0..3 {
        frames.push(seen(live, eyes)?);
    }
    let mut kept: Vec<Seen> = Vec::new();
    for (k, frame) in frames.iter().enumerate() {
        for tip in frame {
            let again = |other: &Seen| apart(tip.pixel, other.pixel) < AGREE_BLURRED_PX && same_way(tip, other);
            let twice = frames.iter().enumerate().any(|(i, other)| i != k && other.iter().any(again));
            if twice && !kept.iter().any(again) {
                kept.push(*tip);
            }
        }
    }
    kept.sort_by(|a, b| b.found.confidence.total_cmp(&a.found.confidence));
    Ok(kept)
}

fn same_way(a: &Seen, b: &Seen) -> bool {
    match (a.found.angle_deg, b.found.angle_deg) {
        (Some(a), Some(b)) => turn_deg(a, b) < TURN_DEG,
        _ => true,
    }
}

/// The mean of two sightings.
fn between(a: &Seen, b: &Seen) -> Seen {
    let mean = |a: f64, b: f64| 0.5 * (a + b);
    let mut both = if a.found.confidence >= b.found.confidence { *a } else { *b };
    both.pixel = Pixel { x_px: mean(a.pixel.x_px, b.pixel.x_px), y_px: mean(a.pixel.y_px, b.pixel.y_px) };
    both.found.at.x_px = mean(a.found.at.x_px, b.found.at.x_px);
    both.found.at.y_px = mean(a.found.at.y_px, b.found.at.y_px);
    both
}

/// What is done with the tips seen at one height; `None`: look on.
pub type Take<'t, T> = dyn FnMut(&mut LiveRig<'_>, &mut dyn Eyes, Vec<Seen>) -> Result<Option<T>, AutoError> + 't;

/// Looks for tips at this height, then above and below it, as far as `reach_um`, until `take` is content with the tips of a
/// height. The focus stays there.
///
/// # Errors
/// [`AutoError::NoTip`], or what `take` says.
pub fn search_until<T>(
    live: &mut LiveRig<'_>,
    eyes: &mut dyn Eyes,
    reach_um: f64,
    take: &mut Take<'_, T>,
) -> Result<T, AutoError> {
    let start = live.pose()?.axis(focus_axis()).0;
    let steps = (reach_um / DEPTH_STEP_UM).ceil() as i32;
    let mut dark = false;
    for k in 0..=2 * steps {
        // 0, up, down, further up, …
        let level = if k % 2 == 1 { (k + 1) / 2 } else { -(k / 2) };
        let at = Micrometres(start + f64::from(level) * DEPTH_STEP_UM);
        match live.move_to(&[(focus_axis(), at)]) {
            Ok(()) => {}
            Err(error) if error.is_local() => continue,
            Err(error) => return Err(error.into()),
        }
        match steady(live, eyes) {
            Ok(tips) if tips.is_empty() => {}
            Ok(tips) => {
                if let Some(taken) = take(live, eyes, tips)? {
                    return Ok(taken);
                }
            }
            Err(AutoError::Dark) => dark = true,
            Err(error) => return Err(error),
        }
    }
    live.move_to(&[(focus_axis(), Micrometres(start))])?;
    Err(if dark { AutoError::Dark } else { AutoError::NoTip { reach_um } })
}

/// Brings a tip into focus: the surest of those wanted that can be. Dirt on the sensor may look like a tip, but cannot; it is
/// seen at every height, and tips with it.
///
/// # Errors
/// None is seen; why the last one could not be focused.
pub fn focus_on_one(
    live: &mut LiveRig<'_>,
    eyes: &mut dyn Eyes,
    plan: &Plan,
    subject: &Subject,
    wanted: &dyn Fn(&mut LiveRig<'_>, Vec<Seen>) -> Vec<Seen>,
) -> Result<(Gaze, Seen), AutoError> {
    let mut refused: Vec<(Pixel, AutoError)> = Vec::new();
    let found = search_until(live, eyes, plan.reach_um, &mut |live, eyes, tips| {
        let height = (focus_axis(), live.pose()?.axis(focus_axis()));
        for tip in wanted(live, tips) {
            let again = |before: &&(Pixel, AutoError)| apart(before.0, tip.pixel) <= FOCUSED_PX;
            if refused.iter().filter(again).count() >= TRIALS {
                continue;
            }
            let gaze = Gaze { subject: subject.clone(), angle_deg: tip.found.angle_deg };
            let rough = Expected { pixel: tip.pixel, within_px: ASTRAY_SHARE * live.window().side_px() };
            match gaze.focus(live, eyes, rough, plan.focus_um) {
                Ok(seen) => return Ok(Some((gaze, seen))),
                Err(error) if error.is_local() => {
                    live.tell(Progress::Passed(error.to_string()));
                    refused.push((tip.pixel, error));
                    live.move_to(&[height])?;
                }
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    });
    found.map_err(|error| match (error, refused.pop()) {
        (AutoError::NoTip { .. }, Some((_, why))) => why,
        (error, _) => error,
    })
}

/// Heights at which the same place is tried to be focused on.
const TRIALS: usize = 2;

impl Gaze {
    /// Where the tip is: two fresh frames agree.
    ///
    /// # Errors
    /// It is not seen, is elsewhere than expected, or does not keep still.
    pub fn look(
        &self,
        live: &mut LiveRig<'_>,
        eyes: &mut dyn Eyes,
        expected: Option<Expected>,
        blurred: bool,
    ) -> Result<Seen, AutoError> {
        let agree = if blurred { AGREE_BLURRED_PX } else { AGREE_PX };
        let (mut earlier, mut empty, mut elsewhere) = (Vec::<Seen>::new(), 0, None);
        for _ in 0..LOOKS {
            let mut tips = seen(live, eyes)?;
            tips.retain(|tip| {
                let way = self.angle_deg.zip(tip.found.angle_deg).is_none_or(|(a, b)| turn_deg(a, b) < TURN_DEG);
                let off = expected.map(|e| (apart(e.pixel, tip.pixel), e.within_px));
                let near = off.is_none_or(|(off, within)| off <= within);
                if way && !near {
                    elsewhere = off;
                }
                way && near
            });
            if tips.is_empty() {
                empty += 1;
                if empty >= EMPTY && earlier.is_empty() {
                    break;
                }
            }
            for tip in &tips {
                if let Some(before) = earlier.iter().find(|before| apart(before.pixel, tip.pixel) <= agree) {
                    let both = between(before, tip);
                    let (subject, confidence) = (self.subject.clone(), both.found.confidence);
                    live.tell(Progress::Found { subject, pixel: both.pixel, confidence });
                    return Ok(both);
                }
            }
            earlier.extend(tips);
        }
        if !earlier.is_empty() {
            return Err(AutoError::Unsteady(self.subject.clone()));
        }
        let subject = self.subject.clone();
        Err(match elsewhere {
            Some((off, within)) => {
                NotFound::Elsewhere { subject, off_px: off.round() as u32, within_px: within.round() as u32 }
            }
            None => NotFound::Unseen(subject),
        }
        .into())
    }

    /// Brings the tip into focus, which is within `reach_um` of the present height, and says where it is.
    ///
    /// # Errors
    /// As [`Self::look`], or the focus is refused.
    pub fn focus(
        &self,
        live: &mut LiveRig<'_>,
        eyes: &mut dyn Eyes,
        rough: Expected,
        reach_um: f64,
    ) -> Result<Seen, AutoError> {
        let mut around = rough.pixel;
        for _ in 0..3 {
            let here = live.pose()?.axis(focus_axis()).0;
            live.focus_tip(focus_axis(), around, (Micrometres(here - reach_um), Micrometres(here + reach_um)))?;
            let seen = self.look(live, eyes, Some(rough), false)?;
            // Focused on something beside it: once more, on itself.
            if apart(seen.pixel, around) <= FOCUSED_PX {
                return Ok(seen);
            }
            around = seen.pixel;
        }
        Err(AutoError::Unsteady(self.subject.clone()))
    }
}

/// A tip this far from the middle of its region is still what was focused on, px.
pub const FOCUSED_PX: f64 = 12.0;
