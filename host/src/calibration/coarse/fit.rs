//! A marker's pose from its edges in one picture or both of a pair.
//!
//! The pose is moved until every border of the marker, seen through the lenses, lies on the edges measured in both pictures
//! at once (Gauss and Newton, Tukey's weights against what is hidden or dirty). Each picture has one nuisance: by how much its edges
//! are drawn in or out all around, as ink that spreads or a tone curve does. What the edges say is kept as the pose's
//! information matrix, so that all views can be adjusted together afterwards without the pictures.

use super::camera::{Lens, Side, StereoCamera};
use super::edges::{Border, Edge, Grey, Tone, borders, measure};
use super::levels::Levels;
use super::marker::Cells;
use super::weighted::{Row, Solved, solve};
use nalgebra::{Isometry3, Matrix6, Point3, SMatrix, Translation3, UnitQuaternion, Vector2, Vector3, Vector6};

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

/// A marker's plane as one of the two cameras sees it: [`look`] without the slope, for the many points that need none.
pub(super) struct Sight<'a> {
    lens: &'a Lens,
    /// The plane's two axes and its origin in the camera's frame.
    plane: [[f64; 3]; 3],
}

impl<'a> Sight<'a> {
    pub fn new(camera: &'a StereoCamera, side: Side, pose: &Isometry3<f64>) -> Self {
        let to_side = camera.from_left(side) * pose;
        let turn = to_side.rotation.to_rotation_matrix();
        let plane = std::array::from_fn(|k| [turn[(k, 0)], turn[(k, 1)], to_side.translation.vector[k]]);
        Self { lens: camera.lens(side), plane }
    }

    /// The pixel of a point of the plane; `None` behind the camera.
    pub fn pixel(&self, p: Vector2<f64>) -> Option<Vector2<f64>> {
        let (px, py) = (p.x, p.y);
        let [x, y, z] = self.plane.map(|[a, b, c]| a * px + b * py + c);
        (z > 1e-9).then(|| self.lens.pixel(Vector2::new(x / z, y / z)))
    }
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
            let sight = Sight::new(camera, side, &pose);
            let project = |p: Vector2<f64>| sight.pixel(p);
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
    kept: [f64; 2],
}

/// Unknowns of a step: the pose's six, and the spread of each picture's edges.
const UNKNOWNS: usize = 8;

/// One step of Gauss and Newton over pose and each picture's spread.
fn adjust(seen: &[Seen], camera: &StereoCamera, pose: &Isometry3<f64>, noise: f64) -> Option<Step> {
    let mut rows: Vec<Row<UNKNOWNS>> = Vec::new();
    for (picture, part) in seen.iter().enumerate() {
        for edge in &part.edges {
            let (_, slope) = look(camera, part.side, pose, edge.middle)?;
            let mut slopes = [0.0; UNKNOWNS];
            for (k, s) in slopes.iter_mut().take(6).enumerate() {
                *s = edge.normal.x * slope[(0, k)] + edge.normal.y * slope[(1, k)];
            }
            slopes[6 + picture] = -1.0;
            let weight = 1.0 / (edge.variance * noise + FLOOR_PX * FLOOR_PX);
            rows.push(Row { slopes, offset: edge.offset_px, weight, picture });
        }
    }
    // A picture that took no part has its spread's prior only.
    let spread = 1.0 / (SPREAD_PX * SPREAD_PX);
    let prior = [1e-9, 1e-9, 1e-9, 0.0, 0.0, 0.0, spread, spread];
    let Solved { by, normal, kept, weights, weighted_squares, squares } = solve(&rows, prior, 6, 1.0)?;
    // Neighbouring pieces share pixels' noise little, but what the model misses they share: no better than the residuals say.
    let unit = (weighted_squares / (weights - (6 + seen.len()) as f64).max(1.0)).max(1.0);
    let spread = normal.fixed_view::<2, 2>(6, 6).try_inverse()?;
    let across = normal.fixed_view::<6, 2>(0, 6).into_owned();
    let information = (normal.fixed_view::<6, 6>(0, 0) - across * spread * across.transpose()) / unit;
    let by = by.fixed_rows::<6>(0).into_owned();
    Some(Step { by, information, rms_px: (squares / weights.max(1.0)).sqrt(), kept })
}
