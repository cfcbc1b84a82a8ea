//! A pipette's direction: from its shank's focus along its length, and from the registered axis that lies along it.

use super::error::AutoError;
use super::gaze::focus_axis;
use crate::calibration::chain::{Chain, Pixel};
use crate::calibration::pipette::{PipetteFit, from_axis, from_shank};
use crate::procedure::{LiveRig, Progress, Seen};
use nalgebra::{Matrix3, Vector3};
use parfocal_protocol::units::Micrometres;

/// Places along the shank besides the tip, and from one to the next, px.
const PLACES: usize = 6;
const STEP_PX: f64 = 22.0;
/// A place's focus is within this of the one before, µm.
const REACH_UM: f64 = 16.0;
/// A shank whose places lie farther off a line, µm, is not trusted.
const STRAIGHT_UM: f64 = 2.0;
/// An axis that a pipette is mounted along is within this of its shank, degrees.
const ALONG_DEG: f64 = 8.0;

/// What is known of a pipette's direction.
#[derive(Clone, Debug)]
pub struct Direction {
    /// The one to use.
    pub fit: PipetteFit,
    /// `shank` or `axis`.
    pub source: &'static str,
}

/// Focuses on the shank behind a tip that is in focus, place by place; in ref, the tip first.
///
/// # Errors
/// Only what ends the whole run: a place that is not focused is passed over.
pub fn follow(live: &mut LiveRig<'_>, chain: &Chain, tip: &Seen) -> Result<Vec<Vector3<f64>>, AutoError> {
    let Some(angle) = tip.found.angle_deg.map(f64::to_radians) else { return Ok(Vec::new()) };
    let mut places = Vec::new();
    for k in 0..=PLACES {
        let back = STEP_PX * k as f64;
        let pixel = Pixel { x_px: tip.pixel.x_px - back * angle.cos(), y_px: tip.pixel.y_px - back * angle.sin() };
        if !live.window().shows(pixel, STEP_PX) {
            break;
        }
        // All of them, the tip too, by the peak of the same measure: what it is off by is the same everywhere.
        let here = live.pose()?.axis(focus_axis()).0;
        match live.focus(focus_axis(), pixel, (Micrometres(here - REACH_UM), Micrometres(here + REACH_UM))) {
            Ok(_) => {}
            Err(error) if error.is_local() => {
                live.tell(Progress::Passed(format!("the shank: {error}")));
                continue;
            }
            Err(error) => return Err(error.into()),
        }
        let microscope = live.microscope()?;
        places.push(chain.pixel_to_ref(microscope, pixel).coordinates);
    }
    Ok(places)
}

/// The pipette's direction: the shank's line if it is straight, else the axis that lies along it, or the one that descends most
/// along the direction seen in the picture. `linear`: of the registration; `azimuth_deg`: as seen from above, if known.
pub fn direction(places: &[Vector3<f64>], linear: &Matrix3<f64>, azimuth_deg: Option<f64>) -> Option<Direction> {
    let shank = (places.len() >= 4).then(|| from_shank(places).ok()).flatten().filter(|fit| fit.rms_um <= STRAIGHT_UM);
    let axes = (0..3).map(|axis| from_axis(linear, axis));
    match shank {
        Some(shank) => {
            // An axis has been measured over a longer way than a shank.
            let along = axes.map(|axis| (axis.direction.coordinates.angle(&shank.direction.coordinates), axis));
            let near =
                along.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(turn, _)| turn.to_degrees() < 0.25 * ALONG_DEG);
            Some(match near {
                Some((_, axis)) => Direction { fit: axis, source: "axis" },
                None => Direction { fit: shank, source: "shank" },
            })
        }
        None => {
            let azimuth = azimuth_deg?;
            let near = |fit: &PipetteFit| super::gaze::turn_deg(fit.azimuth_deg, azimuth);
            axes.filter(|fit| (5.0..75.0).contains(&fit.descent_deg) && near(fit) < ALONG_DEG)
                .min_by(|a, b| near(a).total_cmp(&near(b)))
                .map(|fit| Direction { fit, source: "axis" })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::chain::direction as towards;

    #[test]
    fn a_straight_shank_counts_and_an_axis_along_it_counts_more() {
        let u = towards(30_f64.to_radians(), 0.4).coordinates;
        let places: Vec<_> = (0..6)
            .map(|k| Vector3::new(5.0, 6.0, 7.0) - u * (8.0 * f64::from(k)) + Vector3::z() * 0.2 * f64::from(k % 2))
            .collect();
        let along = Matrix3::from_columns(&[u * 1.03, Vector3::y(), Vector3::z()]);
        let found = direction(&places, &along, None).unwrap();
        assert!(found.source == "axis" && (found.fit.descent_deg - 30.0).abs() < 1e-9);
        let across = Matrix3::identity();
        let found = direction(&places, &across, None).unwrap();
        assert!(found.source == "shank" && (found.fit.descent_deg - 30.0).abs() < 1.0, "{found:?}");
        // Without a shank: by what the picture shows.
        assert_eq!(direction(&[], &along, Some(0.4_f64.to_degrees())).unwrap().source, "axis");
        assert!(direction(&[], &across, Some(90.0)).is_none());
    }
}
