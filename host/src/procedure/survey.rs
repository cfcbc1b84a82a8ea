//! A point that stays where it is, seen from many places of the microscope: what the camera's and the objectives'
//! calibrations are made of.
//!
//! Nothing needs to be known of the camera: small moves first tell how the picture follows the axes, then the point is
//! put at pixels drawn uniformly in the picture, and the map is learned on the way.

use super::draw::{Draws, Share};
use super::error::ProcedureError;
use super::follow::Follow;
use super::guard::{Pose, Targets};
use super::live::{LiveRig, Progress, Seen};
use super::point::{PointFinder, Subject};
use crate::calibration::chain::Pixel;
use crate::calibration::robust::Map;
use crate::rig::{AxisName, Coordinate, Device};
use nalgebra::Vector2;
use parfocal_protocol::units::Micrometres;

/// How to look around.
#[derive(Clone, Debug)]
pub struct Survey {
    /// What stays where it is.
    pub subject: Subject,
    /// Places to see it from, besides the first moves.
    pub places: usize,
    /// Of the draws.
    pub seed: u64,
    /// Whether each place is focused anew, its focus being within this of the last one.
    pub focus_within_um: Option<f64>,
}

/// The point as seen from one place.
#[derive(Clone, Debug)]
pub struct Sighting {
    /// Where everything was.
    pub pose: Pose,
    /// Where the point showed.
    pub seen: Seen,
}

/// The first moves shift the picture by this share of its shorter side.
const FIRST_SHARE: f64 = 0.08;
/// The very first move, µm: little enough for any objective.
const FIRST_UM: f64 = 2.0;
/// Farthest that a first move goes, µm.
const FIRST_FARTHEST_UM: f64 = 600.0;
/// Shifts below this are not told from noise, px.
const LEAST_SHIFT_PX: f64 = 4.0;
/// The point stays this share of the shorter side away from the picture's edge.
pub(super) const MARGIN_SHARE: f64 = 0.1;
/// Once the map is known, a point found farther off than this share of the shorter side is another one.
pub(super) const ASTRAY_SHARE: f64 = 0.15;
/// What is seen farther from the map than this share of the shorter side does not count for it.
pub(super) const ERROR_SHARE: f64 = 0.02;
/// Draws before the room counts as too small.
pub(super) const REDRAWS: usize = 60;

/// Places that may fail before a procedure gives up: as many as give samples, and a few more.
pub(super) fn patience(places: usize) -> usize {
    places + 4
}

fn scope(coordinate: Coordinate) -> AxisName {
    AxisName { device: Device::Scope, coordinate }
}

fn xy(pose: &Pose) -> Vector2<f64> {
    pose.device(Device::Scope).xy()
}

fn px(pixel: Pixel) -> Vector2<f64> {
    Vector2::new(pixel.x_px, pixel.y_px)
}

fn to(at: Vector2<f64>) -> Targets {
    vec![(scope(Coordinate::X), Micrometres(at.x)), (scope(Coordinate::Y), Micrometres(at.y))]
}

/// Looks at the point from many places; `keep` is given each sighting. The microscope goes back to where it was, whether
/// this succeeds or not.
///
/// # Errors
/// The point does not follow, is lost too often, or the microscope has no room.
pub fn survey(
    live: &mut LiveRig<'_>,
    finder: &mut dyn PointFinder,
    survey: &Survey,
    keep: &mut dyn FnMut(&mut LiveRig<'_>, &Sighting) -> Result<(), ProcedureError>,
) -> Result<(), ProcedureError> {
    for coordinate in [Coordinate::X, Coordinate::Y] {
        if !live.guard.has(scope(coordinate)) {
            let what = if coordinate == Coordinate::X { "x" } else { "y" };
            return Err(ProcedureError::NoAxis { device: Device::Scope, what });
        }
    }
    let start = live.pose()?;
    let done = look_around(live, finder, survey, &start, keep);
    let back: Targets = Coordinate::ALL
        .into_iter()
        .map(scope)
        .filter(|name| live.guard.has(*name))
        .map(|name| (name, start.axis(name)))
        .collect();
    let returned = if live.guard.keep_on() { live.move_to(&back) } else { Ok(()) };
    done.and(returned)
}

fn look_around(
    live: &mut LiveRig<'_>,
    finder: &mut dyn PointFinder,
    survey: &Survey,
    start: &Pose,
    keep: &mut dyn FnMut(&mut LiveRig<'_>, &Sighting) -> Result<(), ProcedureError>,
) -> Result<(), ProcedureError> {
    let mut follow = Follow::<2>::new(ERROR_SHARE * live.window().side_px());
    let first = look(live, finder, survey)?;
    follow.add(xy(start), px(first.seen.pixel));
    keep(live, &first)?;
    live.tell(Progress::Recorded { done: 1, of: survey.places + 3 });
    for (k, coordinate) in [Coordinate::X, Coordinate::Y].into_iter().enumerate() {
        let sighting = first_move(live, finder, survey, start, first.seen.pixel, coordinate)?;
        follow.add(xy(&sighting.pose), px(sighting.seen.pixel));
        keep(live, &sighting)?;
        live.tell(Progress::Recorded { done: k + 2, of: survey.places + 3 });
    }
    let Some(mut map) = map(&follow) else {
        return Err(ProcedureError::Implausible {
            what: format!(
                "scope.x and scope.y move {} the same way in the picture: is it one and the same point, and do both axes move?",
                survey.subject
            ),
        });
    };
    let mut draws = Draws::new(survey.seed);
    let mut shares: Vec<Share> = draws.in_picture(survey.places);
    shares.reverse();
    let (mut done, mut passed, mut last) = (0, 0, String::new());
    while done < survey.places {
        let share = shares.pop().unwrap_or_else(|| draws.one());
        let expected = approach(live, &map, share, &mut draws)?;
        let looked = look_near(live, finder, survey, expected).and_then(|sighting| {
            follow.add(xy(&sighting.pose), px(sighting.seen.pixel));
            astray(live, survey, &sighting, expected).map(|()| sighting)
        });
        // Also after a look that was astray: it may be the map that is.
        map = self::map(&follow).unwrap_or(map);
        match looked {
            Ok(sighting) => {
                keep(live, &sighting)?;
                done += 1;
                live.tell(Progress::Recorded { done: done + 3, of: survey.places + 3 });
            }
            Err(error) if error.is_local() => {
                passed += 1;
                last = error.to_string();
                live.tell(Progress::Passed(last.clone()));
            }
            Err(error) => return Err(error),
        }
        if passed > patience(survey.places) {
            return Err(ProcedureError::Lost { got: done + 3, wanted: survey.places + 3, passed, last });
        }
    }
    Ok(())
}

/// Moves so that the point should show at a drawn pixel; draws again where there is no room. Says where it should be.
fn approach(
    live: &mut LiveRig<'_>,
    map: &Map<2>,
    mut share: Share,
    draws: &mut Draws,
) -> Result<Pixel, ProcedureError> {
    let window = live.window();
    let inverse = map.linear.try_inverse().unwrap_or_else(nalgebra::Matrix2::zeros);
    let mut why = None;
    for _ in 0..REDRAWS {
        let pixel = share.pixel(&window, MARGIN_SHARE * window.side_px());
        match live.move_to(&to(inverse * (px(pixel) - map.shift))) {
            Ok(()) => return Ok(pixel),
            Err(error) if error.is_local() => why = Some(error),
            Err(error) => return Err(error),
        }
        share = draws.one();
    }
    let why = why.map_or(String::new(), |e| e.to_string());
    Err(ProcedureError::NoRoom { device: Device::Scope, why, least_um: inverse.norm() * window.side_px() / 4.0 })
}

/// The map so far, if the axes move the picture in two directions.
fn map(follow: &Follow<2>) -> Option<Map<2>> {
    follow.map().filter(|map| {
        let size = map.linear.column(0).norm() * map.linear.column(1).norm();
        map.linear.determinant().abs() > 0.2 * size
    })
}

/// Looks where nobody knows yet where the point should be.
fn look(live: &mut LiveRig<'_>, finder: &mut dyn PointFinder, survey: &Survey) -> Result<Sighting, ProcedureError> {
    let seen = match survey.focus_within_um {
        Some(reach) => live.first_focus_on(finder, &survey.subject, reach)?,
        None => live.find_agreed(finder, &survey.subject)?,
    };
    Ok(Sighting { pose: live.pose()?, seen })
}

/// Looks for the point where it should be; it may be found elsewhere.
fn look_near(
    live: &mut LiveRig<'_>,
    finder: &mut dyn PointFinder,
    survey: &Survey,
    expected: Pixel,
) -> Result<Sighting, ProcedureError> {
    let seen = match survey.focus_within_um {
        Some(reach) => live.focus_on(finder, &survey.subject, Some(expected), reach)?,
        None => live.find(finder, &survey.subject, Some(expected), None)?,
    };
    Ok(Sighting { pose: live.pose()?, seen })
}

/// Refuses what was seen too far from where it should be.
fn astray(live: &LiveRig<'_>, survey: &Survey, sighting: &Sighting, expected: Pixel) -> Result<(), ProcedureError> {
    let within = ASTRAY_SHARE * live.window().side_px();
    let off = (px(expected) - px(sighting.seen.pixel)).norm();
    if off <= within {
        return Ok(());
    }
    let (off_px, within_px) = (off.round() as u32, within.round() as u32);
    Err(super::point::NotFound::Elsewhere { subject: survey.subject.clone(), off_px, within_px }.into())
}

/// Moves one axis far enough for the shift to be measured, beginning very small.
fn first_move(
    live: &mut LiveRig<'_>,
    finder: &mut dyn PointFinder,
    survey: &Survey,
    start: &Pose,
    from: Pixel,
    coordinate: Coordinate,
) -> Result<Sighting, ProcedureError> {
    let axis = scope(coordinate);
    let window = live.window();
    let wish = (FIRST_SHARE * window.side_px()).max(3.0 * LEAST_SHIFT_PX);
    let (mut step, mut turned, mut why) = (FIRST_UM, false, None);
    while step.abs() <= FIRST_FARTHEST_UM {
        let targets =
            to(xy(start) + if coordinate == Coordinate::X { Vector2::new(step, 0.0) } else { Vector2::new(0.0, step) });
        let sighting = match live.move_to(&targets) {
            Ok(()) => look(live, finder, survey),
            Err(error) => Err(error),
        };
        match sighting {
            Ok(sighting) => {
                let shift = (px(sighting.seen.pixel) - px(from)).norm();
                if shift >= 0.7 * wish {
                    return Ok(sighting);
                }
                step *= if shift > LEAST_SHIFT_PX { (1.1 * wish / shift).clamp(1.2, 6.0) } else { 5.0 };
            }
            // Out of view, or no room on this side: the other one.
            Err(error) if error.is_local() && !turned => {
                (turned, step) = (true, -step);
                why = Some(error);
            }
            Err(error) if error.is_local() => {
                let why = why.map_or_else(|| error.to_string(), |first| first.to_string());
                return Err(ProcedureError::NoRoom {
                    device: Device::Scope,
                    why: format!("{axis}: {why}"),
                    least_um: step.abs(),
                });
            }
            Err(error) => return Err(error),
        }
    }
    Err(ProcedureError::Implausible {
        what: format!(
            "moving {axis} by {FIRST_FARTHEST_UM:.0} µm does not move {} in the picture: is it a point that stays while the microscope moves, and does {axis} move?",
            survey.subject
        ),
    })
}
