//! Which views contradict the others.
//!
//! As long as views contradict each other, the one is left out without which the rest agrees best. A marker that loses half of its
//! views that way has moved: nothing tells which of them is right, so all of them go.

use super::super::reject::{CoarseError, Rejected, Why};
use super::adjust::{Loss, Solution, adjust};
use super::{Degrees, MarkerId, Millimetres, Place, View, apart};
use std::collections::BTreeMap;

/// A view contradicts the others when it is off by this many of its standard deviations …
const SIGMAS: f64 = 6.0;
/// … and by this much, so that what pictures never show exactly is forgiven.
const LEAST: (Millimetres, Degrees) = (Millimetres(0.35), Degrees(0.6));
/// Views tried at a time as the one to leave out.
const SUSPECTS: usize = 10;
/// The substrate is what all else is relative to: it is suspected last where two are equally likely.
const SUBSTRATE_LAST: f64 = 1.02;

/// Adjusts, leaving out views until the rest agrees.
pub(super) fn settle(mut views: Vec<&View>, substrate: MarkerId) -> Result<(Solution, Vec<Rejected>), CoarseError> {
    let mut solution = adjust(&views, substrate, None, Loss::Robust);
    let mut out: Vec<(&View, Millimetres, Degrees)> = Vec::new();
    let mut spread = f64::INFINITY;
    while views.len() > 2 {
        solution = adjust(&views, substrate, Some(&solution), Loss::Squares);
        spread = spread.min(noise(&views, substrate, &solution));
        let Some(worst) = suspect(&views, substrate, &solution, spread) else { break };
        let (view, mm, deg) = worst;
        views.retain(|v| !std::ptr::eq(*v, view));
        out.push((view, mm, deg));
        solution = adjust(&views, substrate, None, Loss::Robust);
    }
    let (moved, wrong) = judge(&views, &out, substrate)?;
    views.retain(|v| !moved.iter().any(|r| r.marker == v.marker));
    let solution = adjust(&views, substrate, Some(&solution), Loss::Squares);
    let rejected = moved.into_iter().chain(wrong).collect();
    Ok((solution, rejected))
}

/// By how much the views' own standard deviations are too small, at least 1: from the half of the views that agree best.
fn noise(views: &[&View], substrate: MarkerId, squares: &Solution) -> f64 {
    let freedom = views.len() as f64 - (squares.places.len() + squares.markers(substrate).len() - 1) as f64;
    if freedom < 4.0 {
        return 1.0;
    }
    let robust = adjust(views, substrate, None, Loss::Robust);
    let mut far: Vec<f64> = views.iter().map(|v| robust.misfit(v)).collect();
    far.sort_by(f64::total_cmp);
    // The median of six degrees of freedom is 5.35, of which the adjustment takes its share.
    let typical = 5.35 * freedom / views.len() as f64;
    (far[far.len() / 2] / typical).sqrt().clamp(1.0, 10.0)
}

/// The view without which the rest agrees best, when it contradicts the rest.
fn suspect<'a>(
    views: &[&'a View],
    substrate: MarkerId,
    now: &Solution,
    noise: f64,
) -> Option<(&'a View, Millimetres, Degrees)> {
    let mut order: Vec<&View> = views.to_vec();
    order.sort_by(|a, b| now.misfit(b).total_cmp(&now.misfit(a)));
    let mut best: Option<(f64, &View, Millimetres, Degrees)> = None;
    for view in order.into_iter().take(SUSPECTS) {
        let rest: Vec<&View> = views.iter().filter(|v| !std::ptr::eq(**v, view)).copied().collect();
        let without = adjust(&rest, substrate, None, Loss::Robust);
        let without = adjust(&rest, substrate, Some(&without), Loss::Squares);
        // A view that alone links a marker or a place contradicts nothing.
        let Some(predicted) = without.predict(view.place, view.marker) else { continue };
        let (mm, deg) = apart(&view.pose, &predicted);
        let far = (now.cost - without.cost).max(0.0).sqrt() / noise;
        let cost = if view.marker == substrate { without.cost * SUBSTRATE_LAST + 1.0 } else { without.cost };
        let off = far > SIGMAS && (mm > LEAST.0 || deg > LEAST.1);
        if off && best.as_ref().is_none_or(|b| cost < b.0) {
            best = Some((cost, view, mm, deg));
        }
    }
    best.map(|(_, view, mm, deg)| (view, mm, deg))
}

/// Markers that moved, and single views that are wrong.
fn judge(
    kept: &[&View],
    out: &[(&View, Millimetres, Degrees)],
    substrate: MarkerId,
) -> Result<(Vec<Rejected>, Vec<Rejected>), CoarseError> {
    let mut by_marker: BTreeMap<MarkerId, Vec<&(&View, Millimetres, Degrees)>> = BTreeMap::new();
    for row in out {
        by_marker.entry(row.0.marker).or_default().push(row);
    }
    let (mut moved, mut wrong) = (Vec::new(), Vec::new());
    for (marker, rows) in by_marker {
        let left: Vec<Place> = kept.iter().filter(|v| v.marker == marker).map(|v| v.place).collect();
        if left.len() > rows.len() {
            wrong.extend(rows.iter().map(|(v, mm, deg)| {
                let why = Why::WrongPose { mm: *mm, deg: *deg };
                Rejected { marker, place: Some(v.place), why }
            }));
            continue;
        }
        let mut places: Vec<Place> = left.into_iter().chain(rows.iter().map(|r| r.0.place)).collect();
        places.sort();
        if marker == substrate {
            return Err(CoarseError::SubstrateMoved { substrate, places });
        }
        let (_, mm, deg) = rows[0];
        moved.push(Rejected { marker, place: None, why: Why::Moved { mm: *mm, deg: *deg, places } });
    }
    Ok((moved, wrong))
}
