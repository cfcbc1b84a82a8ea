//! The views of all markers from all places.

use super::super::camera::{Side, StereoCamera};
use super::super::edges::Grey;
use super::super::fit::{Fit, Target, refine};
use super::super::gamma::Sample;
use super::super::graph::{Registration, View, apart};
use super::super::marker::Found;
use super::super::reject::{CoarseError, Rejected, Why};
use super::super::start::{from_one_picture, tipped_over};
use super::super::{MarkerId, Millimetres, Place};
use super::pair::{Match, Read};
use super::{Pair, Settings};
use nalgebra::{Isometry3, Matrix6, Translation3, Vector6};
use std::collections::BTreeMap;

/// Markers found, measured and left out.
#[derive(Default)]
pub(super) struct Views {
    matches: Vec<(Place, Match)>,
    single: Vec<(Place, Side, Found)>,
    targets: BTreeMap<MarkerId, Target>,
    /// Views measured.
    pub seen: Vec<View>,
    /// Views left out.
    pub rejected: Vec<Rejected>,
    /// Every marker found anywhere, and how often.
    pub found: BTreeMap<MarkerId, usize>,
}

/// Sizes by triangulated corners are this good before edges are measured.
const SIZE_OFF: f64 = 0.06;
/// Markers that the pictures' tone is judged by.
const TONE_SAMPLES: usize = 5;
/// What even a perfect fit is not trusted beyond, mm and rad.
const FLOOR: (f64, f64) = (0.015, 0.0003);

impl Views {
    pub fn add(&mut self, read: Read) {
        for id in read.matches.iter().map(|m| m.id).chain(read.single.iter().map(|s| s.1.id)) {
            *self.found.entry(id).or_default() += 1;
        }
        self.rejected.extend(read.rejected);
        self.matches.extend(read.matches.into_iter().map(|m| (read.place, m)));
        self.single.extend(read.single.into_iter().map(|(side, f)| (read.place, side, f)));
    }

    /// Markers that are there twice anywhere are not to be trusted elsewhere; sizes have to be those given.
    pub fn check_sizes(&mut self, settings: &Settings) -> Result<(), CoarseError> {
        let twice: Vec<MarkerId> =
            self.rejected.iter().filter(|r| matches!(r.why, Why::Twice { .. })).map(|r| r.marker).collect();
        self.matches.retain(|(_, m)| !twice.contains(&m.id));
        self.single.retain(|(_, _, f)| !twice.contains(&f.id));
        let mut ratios: Vec<f64> = self.matches.iter().map(|(_, m)| m.measured.0 / settings.size(m.id)).collect();
        ratios.sort_by(f64::total_cmp);
        let Some(typical) = ratios.get(ratios.len() / 2) else { return Ok(()) };
        if (typical - 1.0).abs() > SIZE_OFF {
            return Err(CoarseError::TagSize { measured: typical * settings.tag_mm, given: settings.tag_mm });
        }
        let mut by_marker: BTreeMap<MarkerId, Vec<f64>> = BTreeMap::new();
        for (_, m) in &self.matches {
            by_marker.entry(m.id).or_default().push(m.measured.0);
            self.targets.insert(m.id, settings.target(m.id)?);
        }
        for (_, _, f) in &self.single {
            self.targets.insert(f.id, settings.target(f.id)?);
        }
        for (marker, measured) in by_marker {
            let mean = measured.iter().sum::<f64>() / measured.len() as f64;
            if (mean / settings.size(marker) - 1.0).abs() > 2.0 * SIZE_OFF {
                let why = Why::TagSize { measured_mm: Millimetres(mean) };
                if marker == settings.substrate {
                    return Err(CoarseError::TagSize { measured: mean, given: settings.size(marker) });
                }
                self.rejected.push(Rejected { marker, place: None, why });
                self.matches.retain(|(_, m)| m.id != marker);
                self.single.retain(|(_, _, f)| f.id != marker);
            }
        }
        Ok(())
    }

    /// The markers that fill the most pixels.
    pub fn samples<'a>(&'a self, pairs: &'a [Pair]) -> Vec<Sample<'a>> {
        let mut order: Vec<&(Place, Match)> = self.matches.iter().collect();
        order.sort_by(|a, b| b.1.span_px.total_cmp(&a.1.span_px));
        let sample =
            |(place, m): &&'a (Place, Match)| Some((pictures(pairs, *place)?, self.targets.get(&m.id)?, m.start));
        let all = order.iter().filter_map(sample);
        all.take(TONE_SAMPLES).collect()
    }

    /// Measures every marker that both pictures of a pair show.
    pub fn measure(&mut self, pairs: &[Pair], camera: &StereoCamera, gamma: f64) {
        for (place, m) in &self.matches {
            let Some((pictures, target)) = pictures(pairs, *place).zip(self.targets.get(&m.id)) else { continue };
            // Two pictures tell a pose from the one tipped over, unless noise is large: the one that fits better is right.
            let fits = [m.start, tipped_over(&m.start)]
                .into_iter()
                .filter_map(|start| refine(pictures, camera, target, &start, gamma))
                .filter(|fit| fit.sides.len() == 2);
            match fits.min_by(|a, b| a.rms_px.total_cmp(&b.rms_px)) {
                Some(fit) => self.seen.push(view(*place, m.id, &fit)),
                None => self.rejected.push(Rejected { marker: m.id, place: Some(*place), why: Why::Unclear }),
            }
        }
    }

    /// Measures markers found in one picture of a pair, when the other shows them too where the first says.
    pub fn measure_single(&mut self, pairs: &[Pair], camera: &StereoCamera, gamma: f64) {
        for (place, side, found) in &self.single {
            let Some((pictures, target)) = pictures(pairs, *place).zip(self.targets.get(&found.id)) else { continue };
            let fit = along_the_sight(pictures, camera, *side, found, target, gamma);
            self.seen.extend(fit.map(|fit| view(*place, found.id, &fit)));
        }
    }

    /// Looks for markers where they should be seen but were not found. Returns whether anything was.
    pub fn look_again(
        &mut self,
        pairs: &[Pair],
        camera: &StereoCamera,
        settings: &Settings,
        gamma: f64,
        known: &Registration,
    ) -> Result<bool, CoarseError> {
        let before = self.seen.len();
        for (place, to_camera) in &known.places {
            for (id, marker) in &known.markers {
                let left_out = self.rejected.iter().any(|r| r.marker == *id && r.place.is_none_or(|p| p == *place));
                if left_out || self.seen.iter().any(|v| v.place == *place && v.marker == *id) {
                    continue;
                }
                let Some(pictures) = pictures(pairs, *place) else { continue };
                let start = to_camera * marker.pose;
                let fit = refine(pictures, camera, &settings.target(*id)?, &start, gamma);
                // It is the marker only if it is where it should be.
                let near = |fit: &Fit| {
                    let (mm, deg) = apart(&fit.pose, &start);
                    let loose = if fit.sides.len() == 2 { 1.0 } else { 4.0 };
                    mm.0 < 1.5 * loose && deg.0 < 3.0 * loose
                };
                self.seen.extend(fit.filter(near).map(|fit| view(*place, *id, &fit)));
            }
        }
        Ok(self.seen.len() > before)
    }
}

/// A marker found in one picture, looked for in the other along its line of sight.
fn along_the_sight(
    pictures: [Option<&Grey>; 2],
    camera: &StereoCamera,
    side: Side,
    found: &Found,
    target: &Target,
    gamma: f64,
) -> Option<Fit> {
    let mut best: Option<Fit> = None;
    let to_side = camera.from_left(side);
    for pose in from_one_picture(camera, side, found, target.size_mm) {
        let here = to_side * pose;
        for k in -8..=8 {
            let further = Translation3::from(here.translation.vector * (1.0 + 0.005 * f64::from(k)));
            let start = to_side.inverse() * Isometry3::from_parts(further, here.rotation);
            let fit = refine(pictures, camera, target, &start, gamma).filter(|f| f.sides.len() == 2);
            if let Some(fit) = fit
                && best.as_ref().is_none_or(|b| fit.rms_px < b.rms_px)
            {
                best = Some(fit);
            }
        }
    }
    best.filter(|fit| fit.rms_px < 0.3)
}

fn pictures(pairs: &[Pair], place: Place) -> Option<[Option<&Grey>; 2]> {
    pairs.iter().find(|p| p.place == place).map(|p| [Some(&p.left), Some(&p.right)])
}

fn view(place: Place, marker: MarkerId, fit: &Fit) -> View {
    let (mm, rad) = (FLOOR.0 * FLOOR.0, FLOOR.1 * FLOOR.1);
    let floor = Matrix6::from_diagonal(&Vector6::new(mm, mm, mm, rad, rad, rad));
    let information = fit.information.try_inverse().and_then(|c| (c + floor).try_inverse()).unwrap_or(fit.information);
    let information = (information + information.transpose()) / 2.0;
    View { place, marker, pose: fit.pose, information }
}
