//! One pair of pictures: its markers found, and whether the two pictures belong together.

use super::super::camera::{Side, StereoCamera};
use super::super::edges::{Grey, Tone};
use super::super::fit::Sight;
use super::super::levels::Levels;
use super::super::marker::{Found, find, refuse_mirrored};
use super::super::reject::{CoarseError, Rejected, Why};
use super::super::start::{from_one_picture, from_points, to_corners, triangulated};
use super::super::{MarkerId, Millimetres, Place};
use super::{Pair, Settings};
use nalgebra::{Isometry3, Point3, Vector2};
use std::collections::{BTreeMap, BTreeSet};

/// A marker found in both pictures.
pub(super) struct Match {
    pub id: MarkerId,
    /// A first pose, marker to left camera.
    pub start: Isometry3<f64>,
    /// Side of the black border by triangulation.
    pub measured: Millimetres,
    /// Diagonal in the left picture, px.
    pub span_px: f64,
}

/// What a pair shows.
pub(super) struct Read {
    pub place: Place,
    pub matches: Vec<Match>,
    /// Markers found in one picture only.
    pub single: Vec<(Side, Found)>,
    pub rejected: Vec<Rejected>,
}

/// Corners may lie this far from where the other picture allows them before edges are measured: a share of the marker's diagonal,
/// no less than some px.
const CORNERS_OFF: (f64, f64) = (0.03, 2.5);

/// Between the darkest and the brightest pixel of a picture that shows anything, of 255.
const BLANK: f32 = 8.0;

/// Finds and matches a pair's markers.
pub(super) fn read(pair: &Pair, camera: &StereoCamera, settings: &Settings) -> Result<Read, CoarseError> {
    let place = pair.place;
    for (side, picture) in [(Side::Left, &pair.left), (Side::Right, &pair.right)] {
        let (width, height, expected) = (picture.width, picture.height, camera.image_size);
        if [width, height] != expected {
            return Err(CoarseError::Size { place, side, width, height, expected });
        }
        let (low, high) = picture.values.iter().fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
        if high - low < BLANK {
            return Err(CoarseError::Blank { place, side });
        }
    }
    if alike(&pair.left, &pair.right) {
        return Err(CoarseError::SamePicture(place));
    }
    let mut rejected = Vec::new();
    let mut twice = BTreeSet::new();
    let mut found: [BTreeMap<MarkerId, Found>; 2] = [BTreeMap::new(), BTreeMap::new()];
    for (side, picture) in [(Side::Left, &pair.left), (Side::Right, &pair.right)] {
        let all = find(picture)?;
        refuse_mirrored(picture, &all, place, side)?;
        for tag in all {
            if found[side as usize].insert(tag.id, tag).is_some() && twice.insert(tag.id) {
                if tag.id == settings.substrate {
                    return Err(CoarseError::SubstrateTwice { substrate: tag.id, place, side });
                }
                rejected.push(Rejected { marker: tag.id, place: Some(place), why: Why::Twice { side } });
            }
        }
    }
    let [left, right] = &mut found;
    left.retain(|id, _| !twice.contains(id));
    right.retain(|id, _| !twice.contains(id));
    let mut matches = Vec::new();
    let mut strays = Vec::new();
    let mut behind = 0;
    for (id, l) in left.iter() {
        let Some(r) = right.get(id) else { continue };
        let points = triangulated(camera, l, r);
        if points.is_some_and(|p| p.iter().all(|p| p.z < 0.0)) {
            behind += 1;
            continue;
        }
        let ahead = points.filter(|p| p.iter().all(|p| p.z > 1.0));
        let off = ahead.map_or(f64::INFINITY, |p| corners_off(camera, &p, l, r));
        let start = ahead.and_then(|points| {
            let measured = Millimetres(side_length(&points));
            let both = [(Side::Left, l), (Side::Right, r)];
            let (_, start) = to_corners(camera, &both, &from_points(&points, measured.0)?, measured.0)?;
            Some(Match { id: *id, start, measured, span_px: l.span() })
        });
        match start {
            Some(start) if off < (CORNERS_OFF.0 * l.span()).max(CORNERS_OFF.1) => matches.push(start),
            _ => strays.push((*id, off)),
        }
    }
    let common = matches.len() + strays.len() + behind;
    if behind * 2 > common {
        return Err(CoarseError::Swapped(place));
    }
    if strays.len() * 2 > common {
        let mut off: Vec<f64> = strays.iter().map(|s| s.1).filter(|px| px.is_finite()).collect();
        off.sort_by(f64::total_cmp);
        return Err(CoarseError::OutOfOrder { place, px: off.get(off.len() / 2).copied().unwrap_or(f64::NAN) });
    }
    for (marker, px) in strays {
        rejected.push(Rejected { marker, place: Some(place), why: Why::NoStereoMatch { px } });
    }
    let alone = |side: Side| {
        let other = &found[1 - side as usize];
        let picture = if side == Side::Left { &pair.left } else { &pair.right };
        let lone = found[side as usize].values().filter(|f| !other.contains_key(&f.id));
        lone.filter(move |f| looks_like(picture, camera, side, f, settings)).map(move |f| (side, *f))
    };
    let single = Side::BOTH.into_iter().flat_map(alone).collect();
    Ok(Read { place, matches, single, rejected })
}

/// Whether the picture shows that marker there, and not clutter that happens to read as one: for lack of a second picture, the squares are compared.
fn looks_like(picture: &Grey, camera: &StereoCamera, side: Side, found: &Found, settings: &Settings) -> bool {
    let (Ok(target), tone) = (settings.target(found.id), Tone { gamma: 1.0, blur_px: 1.0 }) else { return false };
    from_one_picture(camera, side, found, target.size_mm).iter().any(|pose| {
        let sight = Sight::new(camera, side, pose);
        let project = |p: Vector2<f64>| sight.pixel(p);
        Levels::read(picture, &target.cells, target.size_mm, tone, &project).is_some_and(|l| l.likeness > LIKENESS)
    })
}

/// Correlation with the marker's squares that clutter does not reach.
const LIKENESS: f64 = 0.8;

/// Root mean square distance of the corners from the pixels that their triangulated points have, px.
fn corners_off(camera: &StereoCamera, points: &[Point3<f64>; 4], left: &Found, right: &Found) -> f64 {
    let off = |side: Side, found: &Found| -> Option<f64> {
        points
            .iter()
            .zip(&found.corners)
            .map(|(p, c)| Some((camera.lens(side).project(&(camera.from_left(side) * p))?.0 - c).norm_squared()))
            .sum()
    };
    let total = off(Side::Left, left).zip(off(Side::Right, right)).map_or(f64::INFINITY, |(a, b)| a + b);
    // Both pictures share the distance between the two rays.
    2.0 * (total / 8.0).sqrt()
}

fn side_length(p: &[Point3<f64>; 4]) -> f64 {
    (0..4).map(|k| (p[k] - p[(k + 1) % 4]).norm()).sum::<f64>() / 4.0
}

/// Whether two pictures are one and the same but for a level or two.
fn alike(a: &Grey, b: &Grey) -> bool {
    let far = a.values.iter().zip(&b.values).map(|(x, y)| f64::from((x - y).abs())).sum::<f64>();
    far / (a.values.len() as f64) < 0.5
}
