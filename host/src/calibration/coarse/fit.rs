//! A marker's pose from its edges in one picture or both of a pair.
//!
//! The pose is moved until every border of the marker, seen through the lenses, lies on the edges measured in both pictures
//! at once (Gauss and Newton, Tukey's weights against what is hidden or dirty). Each picture has one nuisance: by how much its edges
//! are drawn in or out all around, as ink that spreads or a tone curve does. What the edges say is kept as the pose's
//! information matrix, so that all views can be adjusted together afterwards without the pictures.

use super::camera::{Side, StereoCamera};
use super::edges::{Border, Edge, Grey, Tone, borders, measure};
use super::levels::Levels;
use super::marker::Cells;
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix6, Point3, SMatrix, Translation3, UnitQuaternion, Vector2, Vector3, Vector6,
};

/// A marker to be measured: its squares, borders and size.
#[derive(Clone, Debug)]
pub struct Target {
    /// Its squares.
    pub cells: Cells,
    /// Length of the black border's outer edge, mm.
    pub size_mm: f64,
    borders: Vec<Border>,
}

impl Target {
    /// A marker with these squares and this size.
    pub fn new(cells: Cells, size_mm: f64) -> Self {
        Self { cells, size_mm, borders: borders(&cells, size_mm) }
    }
}

/// A marker's pose in the left camera's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Marker to left camera, mm.
    pub pose: Isometry3<f64>,
    /// Information of a small move in the marker's frame, see [`nudge`]: mm⁻² and rad⁻².
    pub information: Matrix6<f64>,
    /// The pictures that took part.
    pub sides: Vec<Side>,
    /// Root mean square of the edges' distances that were not rejected, px.
    pub rms_px: f64,
    /// Blur found in each picture, px.
    pub blur_px: [f64; 2],
    /// Squared misfit of the pixels, levels², the median over the edges' pieces.
    pub noise: f64,
}

/// A pose moved by (ρ, ω), mm and rad, given in the moved body's own frame.
pub fn nudge(pose: &Isometry3<f64>, by: &Vector6<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(by[3], by[4], by[5]));
    let shift = pose.rotation * Vector3::new(by[0], by[1], by[2]);
    Isometry3::from_parts(Translation3::from(pose.translation.vector + shift), pose.rotation * turn)
}

/// The (ρ, ω) that [`nudge`] needs to get from one pose to another.
pub fn difference(from: &Isometry3<f64>, to: &Isometry3<f64>) -> Vector6<f64> {
    let shift = from.rotation.inverse() * (to.translation.vector - from.translation.vector);
    let turn = (from.rotation.inverse() * to.rotation).scaled_axis();
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

/// Pixel of a point of the marker's plane, and its change with a nudge of the pose.
pub(super) fn look(
    camera: &StereoCamera,
    side: Side,
    pose: &Isometry3<f64>,
    p: Vector2<f64>,
) -> Option<(Vector2<f64>, SMatrix<f64, 2, 6>)> {
    let to_side = camera.from_left(side) * pose;
    let point = Point3::new(p.x, p.y, 0.0);
    let (pixel, slope) = camera.lens(side).project(&(to_side * point))?;
    let turned = slope * to_side.rotation.to_rotation_matrix().matrix();
    let mut jacobian = SMatrix::<f64, 2, 6>::zeros();
    jacobian.fixed_columns_mut::<3>(0).copy_from(&turned);
    jacobian.fixed_columns_mut::<3>(3).copy_from(&(-turned * point.coords.cross_matrix()));
    Some((pixel, jacobian))
}

/// Edges measured in one picture.
struct Seen {
    side: Side,
    edges: Vec<Edge>,
    tried: usize,
}

/// What one picture's edges are worth below which it is left out: share of pieces measured and kept, likeness to the pattern.
const LEAST_SHARE: f64 = 0.3;
const LEAST_LIKENESS: f64 = 0.6;
/// What no model of an edge is better than, px.
const FLOOR_PX: f64 = 0.015;
/// Expected drawing in or out of the edges, px.
const SPREAD_PX: f64 = 0.25;
const ROUNDS: usize = 8;

/// Refines a pose over the pictures given; a picture in which the marker is not there to be measured drops out. `None` when none is left.
pub fn refine(
    pictures: [Option<&Grey>; 2],
    camera: &StereoCamera,
    target: &Target,
    start: &Isometry3<f64>,
    gamma: f64,
) -> Option<Fit> {
    let mut pose = *start;
    let mut blur = [1.1; 2];
    let mut result = None;
    let mut pictures = pictures;
    for round in 0..ROUNDS {
        let mut seen = Vec::new();
        let mut noise: Vec<f64> = Vec::new();
        for side in Side::BOTH {
            let k = side as usize;
            let Some(picture) = pictures[k] else { continue };
            let project = |p: Vector2<f64>| look(camera, side, &pose, p).map(|(pixel, _)| pixel);
            let tone = Tone { gamma, blur_px: blur[k] };
            let levels = Levels::read(picture, &target.cells, target.size_mm, tone, &project);
            let levels = levels.filter(|l| l.likeness > LEAST_LIKENESS);
            let (edges, tried) = levels.map_or((Vec::new(), 1), |levels| {
                measure(picture, &target.borders, target.size_mm, tone, &levels, &project)
            });
            if (edges.len() as f64) < LEAST_SHARE * tried as f64 || edges.len() < 12 {
                pictures[k] = None;
                continue;
            }
            blur[k] = sharpen(&edges, blur[k]);
            noise.extend(edges.iter().map(|e| e.misfit.0 / e.misfit.1));
            seen.push(Seen { side, edges, tried });
        }
        if seen.is_empty() {
            return None;
        }
        noise.sort_by(f64::total_cmp);
        let noise = noise[noise.len() / 2];
        let step = adjust(&seen, camera, &pose, noise)?;
        for (seen, share) in seen.iter().zip(&step.kept) {
            if round > 2 && *share < LEAST_SHARE * seen.tried as f64 {
                pictures[seen.side as usize] = None;
            }
        }
        pose = nudge(&pose, &step.by);
        let sides = seen.iter().map(|s| s.side).collect();
        let still = step.by.fixed_rows::<3>(0).amax() < 5e-4 && step.by.fixed_rows::<3>(3).amax() < 2e-5;
        result = Some(Fit { pose, information: step.information, sides, rms_px: step.rms_px, blur_px: blur, noise });
        if still && round >= 3 {
            break;
        }
    }
    result.filter(|fit| fit.sides.iter().all(|s| pictures[*s as usize].is_some()))
}

/// The blur that the pieces' own residuals ask for.
fn sharpen(edges: &[Edge], blur: f64) -> f64 {
    // Pieces with the largest misfits may be partly hidden.
    let mut order: Vec<&Edge> = edges.iter().collect();
    order.sort_by(|a, b| (a.misfit.0 / a.misfit.1).total_cmp(&(b.misfit.0 / b.misfit.1)));
    let kept = &order[..(order.len() * 3).div_ceil(4)];
    let sum = kept.iter().fold((0.0, 0.0), |s, e| (s.0 + e.sharper.0, s.1 + e.sharper.1));
    (blur + (sum.0 / sum.1.max(1e-9)).clamp(-0.4, 0.4)).clamp(0.45, 6.0)
}

struct Step {
    by: Vector6<f64>,
    information: Matrix6<f64>,
    rms_px: f64,
    /// Sum of Tukey weights, per picture.
    kept: Vec<f64>,
}

/// One step of Gauss and Newton over pose and each picture's spread.
fn adjust(seen: &[Seen], camera: &StereoCamera, pose: &Isometry3<f64>, noise: f64) -> Option<Step> {
    let size = 6 + seen.len();
    let mut rows: Vec<(DVector<f64>, f64, f64, usize)> = Vec::new();
    for (k, part) in seen.iter().enumerate() {
        for edge in &part.edges {
            let (_, slope) = look(camera, part.side, pose, edge.middle)?;
            let mut row = DVector::zeros(size);
            row.rows_mut(0, 6).copy_from(&(edge.normal.transpose() * slope).transpose());
            row[6 + k] = -1.0;
            rows.push((row, edge.offset_px, 1.0 / (edge.variance * noise + FLOOR_PX * FLOOR_PX), k));
        }
    }
    let mut by = DVector::zeros(size);
    let mut normal = DMatrix::zeros(size, size);
    let mut scale = f64::INFINITY;
    let mut kept = vec![0.0; seen.len()];
    let mut sums = (0.0, 0.0, 0.0);
    for _ in 0..6 {
        normal.fill(0.0);
        let mut gradient = DVector::zeros(size);
        kept.fill(0.0);
        sums = (0.0, 0.0, 0.0);
        for (row, offset, weight, k) in &rows {
            let miss = offset - row.dot(&by);
            let robust = tukey(miss * weight.sqrt() / scale);
            kept[*k] += robust;
            normal.ger(weight * robust, row, row, 1.0);
            gradient.axpy(weight * robust * offset, row, 1.0);
            sums = (sums.0 + robust, sums.1 + robust * weight * miss * miss, sums.2 + robust * miss * miss);
        }
        for k in 0..seen.len() {
            normal[(6 + k, 6 + k)] += 1.0 / (SPREAD_PX * SPREAD_PX);
        }
        for k in 0..3 {
            normal[(k, k)] += 1e-9;
        }
        by = normal.clone().cholesky()?.solve(&gradient);
        let mut far: Vec<f64> =
            rows.iter().map(|(row, offset, w, _)| (offset - row.dot(&by)).abs() * w.sqrt()).collect();
        far.sort_by(f64::total_cmp);
        scale = (1.4826 * far[far.len() / 2]).max(1.0);
    }
    // Neighbouring pieces share pixels' noise little, but what the model misses they share: no better than the residuals say.
    let unit = (sums.1 / (sums.0 - size as f64).max(1.0)).max(1.0);
    let spread = normal.view((6, 6), (seen.len(), seen.len())).into_owned().try_inverse()?;
    let across = normal.view((0, 6), (6, seen.len())).into_owned();
    let pose_part = normal.view((0, 0), (6, 6)).into_owned() - &across * spread * across.transpose();
    let information = Matrix6::from_iterator(pose_part.iter().map(|v| v / unit));
    let by = Vector6::from_iterator(by.iter().take(6).copied());
    Some(Step { by, information, rms_px: (sums.2 / sums.0.max(1.0)).sqrt(), kept })
}

/// Tukey's biweight at 4.685 standard deviations.
pub(super) fn tukey(r: f64) -> f64 {
    let u = (r / 4.685).powi(2);
    if u < 1.0 { (1.0 - u).powi(2) } else { 0.0 }
}
