//! A tip's height, the same through every objective.
//!
//! A focus measure has two peaks at a tip, one to each side of its glass, and either may win; they lie the farther apart the
//! smaller the aperture. The glass' own blur knows no such sides: as the tip detector's fit tells it, signed by whether the
//! tip lies above or below the focal plane, it falls on a line over the heights, which is zero in focus.

use super::error::ProcedureError;
use super::live::{LiveRig, Progress};
use crate::calibration::chain::Pixel;
use crate::rig::AxisName;
use crate::tip::{Expect, detect_all};
use parfocal_protocol::units::Micrometres;

/// Heights at which a tip is looked at, in depths of field: two by two from where a scan left it, until they lie on a line…
const FIRST: [[f64; 2]; 2] = [[-4.0, 4.0], [-2.0, 2.0]];
/// … then about where that is zero, of which so many at least have to show it.
const THEN: [f64; 6] = [-2.5, -1.5, -0.5, 0.5, 1.5, 2.5];
const LEAST: usize = 4;
/// The focus is no farther from the peak that a scan found, depths of field.
const FARTHEST: f64 = 8.0;
/// What a depth of field adds to a tip's blur, px of the frame: 2.6 through the objectives that were looked at, at 0.32 µm
/// times 40 over their magnification. A fit whose blur grows otherwise does not know the tip, as it does not the one real tip of docs/tips.md.
const PER_DEPTH_PX: std::ops::RangeInclusive<f64> = 1.5..=6.0;
/// Blurs that lie farther off their line, in the blur that a depth of field makes, do not tell.
const OFF_LINE: f64 = 0.5;
/// Side of the part of a frame in which a tip is looked for, and how far from its place it may be, px of the frame.
const SIDE: usize = 192;
const NEAR_PX: f64 = 24.0;

/// Where an axis is, and a tip's blur there, px.
type Blur = (f64, f64);

/// Moves `axis` from a peak of the focus measure at `around` to where the glass of the tip there is sharpest, within `range`,
/// and says where that is. `None`, and the axis where it was: there is no tip, or its blur does not tell.
///
/// # Errors
/// Only what ends a procedure.
pub(super) fn level(
    live: &mut LiveRig<'_>,
    axis: AxisName,
    around: Pixel,
    range: (Micrometres, Micrometres),
) -> Result<Option<Micrometres>, ProcedureError> {
    let Some(here) = blur(live, around)? else { return Ok(None) };
    let start = live.pose()?.axis(axis);
    let depth = live.depth_of_field_um().unwrap_or(1.0);
    let (low, high) = (range.0.0.max(start.0 - FARTHEST * depth), range.1.0.min(start.0 + FARTHEST * depth));
    let mut look = |blurs: &mut Vec<Blur>, from: f64, rungs: &[f64]| -> Result<(), ProcedureError> {
        for at in rungs.iter().map(|rung| from + rung * depth).filter(|at| (range.0.0..=range.1.0).contains(at)) {
            match live.move_to(&[(axis, Micrometres(at))]) {
                Ok(()) => blurs.extend(blur(live, around)?.map(|blur| (at, blur))),
                Err(error) if error.is_local() => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    };
    let focus = |blurs: &[Blur]| zero(blurs, depth).filter(|at| (low..=high).contains(at));
    let mut blurs = vec![(start.0, here)];
    let mut found = None;
    for rungs in FIRST {
        look(&mut blurs, start.0, &rungs)?;
        found = if blurs.len() > 2 { focus(&blurs) } else { None };
        if found.is_some() {
            break;
        }
    }
    if let Some(rough) = found {
        blurs.clear();
        look(&mut blurs, rough, &THEN)?;
        found = if blurs.len() >= LEAST { focus(&blurs) } else { None };
    }
    let at = found.map_or(start, Micrometres);
    live.move_to(&[(axis, at)])?;
    live.tell(match found {
        Some(_) => Progress::Focused { axis, at },
        None => Progress::Warning("the tip's blur does not tell its height; it is that of its sharpest edge".into()),
    });
    Ok(found.map(Micrometres))
}

/// The blur of the tip at a place, in a fresh frame.
fn blur(live: &mut LiveRig<'_>, around: Pixel) -> Result<Option<f64>, ProcedureError> {
    let window = live.window();
    let (part, at) = (window.region(around, SIDE), window.to_frame(around));
    let (frame, left) = live.fresh_part(Some(part))?;
    let whole = frame.picture.view();
    let Ok(view) = left.map_or(Ok(whole), |part| whole.crop(part)) else { return Ok(None) };
    let off = |x: f64, y: f64| (x + part.x as f64 - at.x_px).hypot(y + part.y as f64 - at.y_px);
    let tips = detect_all(&view, &Expect::default());
    let near = tips.iter().map(|tip| (off(tip.x_px, tip.y_px), tip.blur_px)).filter(|(off, _)| *off <= NEAR_PX);
    Ok(near.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, blur)| blur))
}

/// Where the line through blurs is zero: the median of all slopes between two of them (Theil and Sen), so that a few wrong
/// ones do no harm. `None` if they lie on no line.
fn zero(blurs: &[Blur], depth: f64) -> Option<f64> {
    let pairs = blurs.iter().enumerate().flat_map(|(i, a)| blurs[..i].iter().map(move |b| (a.1 - b.1) / (a.0 - b.0)));
    let slope = median(pairs.collect())?;
    let shift = median(blurs.iter().map(|(at, blur)| blur - slope * at).collect())?;
    let off = median(blurs.iter().map(|(at, blur)| (blur - slope * at - shift).abs()).collect())?;
    let per_depth = depth * slope.abs();
    (PER_DEPTH_PX.contains(&per_depth) && off <= OFF_LINE * per_depth).then_some(-shift / slope)
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    (n > 0).then(|| 0.5 * (values[(n - 1) / 2] + values[n / 2]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blurs_on_a_line_tell_the_focus_though_some_are_wrong() {
        let line: Vec<Blur> = (-3..=3).map(|k| (f64::from(k), -2.6 * (f64::from(k) - 0.4))).collect();
        assert!((zero(&line, 1.0).unwrap() - 0.4).abs() < 1e-9);
        let mut wrong = line.clone();
        (wrong[1].1, wrong[5].1) = (-2.0, 30.0);
        assert!((zero(&wrong, 1.0).unwrap() - 0.4).abs() < 0.3);
    }

    #[test]
    fn blurs_on_no_line_tell_nothing() {
        let same: Vec<Blur> = (-3..=3).map(|k| (f64::from(k), 2.0)).collect();
        assert_eq!(zero(&same, 1.0), None);
        let scattered = [3.0, -9.0, 8.0, 1.0, -7.0, 9.0, -2.0];
        let scattered: Vec<Blur> = scattered.iter().zip(0..).map(|(b, k)| (f64::from(k), *b)).collect();
        assert_eq!(zero(&scattered, 1.0), None);
        // The real stack's planes 22 to 28, 1.57 µm apart: fitted blurs that do not follow the focus.
        let real = [-4.80, -7.72, -4.62, -2.75, -1.55, -2.19, -4.69];
        let real: Vec<Blur> = real.iter().zip(0..).map(|(b, k)| (1.57 * f64::from(k), *b)).collect();
        assert_eq!(zero(&real, 1.0), None);
        assert_eq!(zero(&[], 1.0), None);
    }
}
