//! Least squares over places and markers.

use super::super::fit::{difference, nudge};
use super::super::weighted::tukey;
use super::{Degrees, MarkerId, MarkerPose, Millimetres, Place, View, apart, linked};
use nalgebra::{DMatrix, DVector, Isometry3, Matrix6, Vector6};
use std::collections::BTreeMap;

/// Poses of places and markers, and what is known of their errors.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Substrate marker to camera.
    pub places: BTreeMap<Place, Isometry3<f64>>,
    /// Marker to substrate marker, the substrate's own left out.
    poses: BTreeMap<MarkerId, Isometry3<f64>>,
    covariance: BTreeMap<MarkerId, Matrix6<f64>>,
    /// Weighted sum of squared residuals.
    pub cost: f64,
    substrate: MarkerId,
}

impl Solution {
    /// A marker's pose; the substrate's is the identity.
    pub fn marker(&self, id: MarkerId) -> Option<Isometry3<f64>> {
        if id == self.substrate { Some(Isometry3::identity()) } else { self.poses.get(&id).copied() }
    }

    /// The pose in which a view's marker should be seen from its place.
    pub fn predict(&self, place: Place, marker: MarkerId) -> Option<Isometry3<f64>> {
        Some(self.places.get(&place)? * self.marker(marker)?)
    }

    /// The view's squared distance from what is predicted, in its own standard deviations.
    pub fn misfit(&self, view: &View) -> f64 {
        self.predict(view.place, view.marker).map_or(0.0, |p| {
            let e = difference(&view.pose, &p);
            e.dot(&(view.information * e))
        })
    }

    /// Poses with their uncertainties.
    pub fn markers(&self, substrate: MarkerId) -> BTreeMap<MarkerId, MarkerPose> {
        let exact = MarkerPose { pose: Isometry3::identity(), position: Millimetres(0.0), orientation: Degrees(0.0) };
        let mut all = BTreeMap::from([(substrate, exact)]);
        for (id, pose) in &self.poses {
            let spread = self.covariance.get(id).map_or_else(Vector6::zeros, Matrix6::diagonal);
            let length = |from: usize| spread.fixed_rows::<3>(from).sum().max(0.0).sqrt();
            let (position, orientation) = (Millimetres(length(0)), Degrees(length(3).to_degrees()));
            all.insert(*id, MarkerPose { pose: *pose, position, orientation });
        }
        all
    }
}

/// First poses: outwards from the substrate, then each place and marker at the one of its candidates that agrees best with the rest.
fn start(views: &[&View], substrate: MarkerId) -> Solution {
    let mut s =
        Solution { places: BTreeMap::new(), poses: BTreeMap::new(), covariance: BTreeMap::new(), cost: 0.0, substrate };
    let (markers, places) = linked(views, substrate);
    loop {
        let before = s.places.len() + s.poses.len();
        for v in views.iter().filter(|v| markers.contains(&v.marker)) {
            match (s.places.get(&v.place).copied(), s.marker(v.marker)) {
                (None, Some(m)) => drop(s.places.insert(v.place, v.pose * m.inverse())),
                (Some(c), None) => drop(s.poses.insert(v.marker, c.inverse() * v.pose)),
                _ => {}
            }
        }
        if s.places.len() + s.poses.len() == before {
            break;
        }
    }
    for _ in 0..2 {
        for place in &places {
            let candidates = views.iter().filter(|v| v.place == *place);
            let candidates: Vec<_> = candidates.filter_map(|v| Some(v.pose * s.marker(v.marker)?.inverse())).collect();
            // What counts is where the markers come to lie, not the camera's own place far away from them.
            let miss = |c: &Isometry3<f64>, v: &View| s.marker(v.marker).map(|m| distance(&(c * m), &v.pose));
            let here: Vec<&&View> = views.iter().filter(|v| v.place == *place).collect();
            let total = |c: &Isometry3<f64>| here.iter().filter_map(|v| miss(c, v)).sum::<f64>();
            if let Some(best) = candidates.iter().min_by(|a, b| total(a).total_cmp(&total(b))) {
                s.places.insert(*place, *best);
            }
        }
        for id in markers.iter().filter(|id| **id != substrate) {
            let candidates = views.iter().filter(|v| v.marker == *id);
            let candidates: Vec<_> =
                candidates.filter_map(|v| Some(s.places.get(&v.place)?.inverse() * v.pose)).collect();
            let total = |m: &Isometry3<f64>| candidates.iter().map(|c| distance(c, m)).sum::<f64>();
            if let Some(best) = candidates.iter().min_by(|a, b| total(a).total_cmp(&total(b))) {
                s.poses.insert(*id, *best);
            }
        }
    }
    s
}

/// A distance that grows slowly: mm plus degrees, no more than 20.
fn distance(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let (mm, deg) = apart(a, b);
    (mm.0 + deg.0).min(20.0)
}

/// How strongly large residuals count.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Loss {
    /// As squares.
    Squares,
    /// Tukey's biweight, for views that may contradict each other.
    Robust,
}

/// Adjusts from `from`, or from scratch. Views that nothing links to the substrate are left out.
pub(super) fn adjust(views: &[&View], substrate: MarkerId, from: Option<&Solution>, loss: Loss) -> Solution {
    let mut s = start(views, substrate);
    if let Some(from) = from {
        let keep = |known: Option<&Isometry3<f64>>, pose: &mut Isometry3<f64>| *pose = *known.unwrap_or(pose);
        s.places.iter_mut().for_each(|(k, pose)| keep(from.places.get(k), pose));
        s.poses.iter_mut().for_each(|(k, pose)| keep(from.poses.get(k), pose));
    }
    let places: Vec<Place> = s.places.keys().copied().collect();
    let markers: Vec<MarkerId> = s.poses.keys().copied().collect();
    let column = |v: &View| {
        let place = places.binary_search(&v.place).ok()?;
        let marker = markers.binary_search(&v.marker).ok();
        (marker.is_some() || v.marker == substrate).then_some((6 * place, marker.map(|m| 6 * (places.len() + m))))
    };
    let size = 6 * (places.len() + markers.len());
    let rows: Vec<(&View, usize, Option<usize>)> =
        views.iter().filter_map(|v| column(v).map(|(p, m)| (*v, p, m))).collect();
    let mut normal = DMatrix::zeros(size, size);
    for _ in 0..30 {
        normal.fill(0.0);
        let mut gradient = DVector::zeros(size);
        let far: Vec<f64> = rows.iter().map(|(v, ..)| (s.misfit(v) / 6.0).sqrt()).collect();
        let scale = median(&far).max(1.0) * 1.5;
        for ((view, p, m), far) in rows.iter().zip(&far) {
            let weight = if loss == Loss::Robust { tukey(far / scale).max(1e-6) } else { 1.0 };
            add(&s, view, *p, *m, weight, &mut normal, &mut gradient);
        }
        let damped = &normal + DMatrix::from_diagonal(&(normal.diagonal() * 1e-9));
        let Some(by) = damped.cholesky().map(|c| c.solve(&gradient)) else { break };
        for (k, pose) in s.places.values_mut().chain(s.poses.values_mut()).enumerate() {
            *pose = nudge(pose, &by.fixed_rows::<6>(6 * k).into_owned());
        }
        if by.amax() < 1e-9 {
            break;
        }
    }
    s.cost = rows.iter().map(|(v, ..)| s.misfit(v)).sum();
    let freedom = (6 * rows.len()).saturating_sub(size);
    let unit = if freedom > 0 { (s.cost / freedom as f64).max(1.0) } else { 1.0 };
    if let Some(inverse) = normal.cholesky().map(|c| c.inverse()) {
        for (k, id) in markers.iter().enumerate() {
            let at = 6 * (places.len() + k);
            s.covariance.insert(*id, inverse.fixed_view::<6, 6>(at, at) * unit);
        }
    }
    s
}

/// Adds one view's part to the normal equations.
fn add(
    s: &Solution,
    view: &View,
    place: usize,
    marker: Option<usize>,
    weight: f64,
    normal: &mut DMatrix<f64>,
    gradient: &mut DVector<f64>,
) {
    let Some((c, m)) = s.places.get(&view.place).zip(s.marker(view.marker)) else { return };
    let miss = -difference(&view.pose, &(c * m));
    let turn = |q: nalgebra::UnitQuaternion<f64>| q.to_rotation_matrix().into_inner();
    let back = view.pose.rotation.inverse();
    let mut by_place = Matrix6::zeros();
    let to_place = turn(back * c.rotation);
    by_place.fixed_view_mut::<3, 3>(0, 0).copy_from(&to_place);
    by_place.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-to_place * m.translation.vector.cross_matrix()));
    by_place.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn(m.rotation.inverse()));
    let mut by_marker = Matrix6::identity();
    by_marker.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn(back * c.rotation * m.rotation));
    let weighted = view.information * weight;
    let blocks: Vec<(usize, &Matrix6<f64>)> =
        std::iter::once((place, &by_place)).chain(marker.map(|at| (at, &by_marker))).collect();
    for (i, a) in &blocks {
        let part: Vector6<f64> = a.transpose() * weighted * miss;
        let mut rows = gradient.fixed_rows_mut::<6>(*i);
        rows += part;
        for (j, b) in &blocks {
            let mut block = normal.fixed_view_mut::<6, 6>(*i, *j);
            block += a.transpose() * weighted * *b;
        }
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}
