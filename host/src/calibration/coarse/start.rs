//! First poses of markers, from their corners alone: by triangulation, and from one picture.

use super::camera::{Side, StereoCamera};
use super::fit::{look, nudge};
use super::marker::{Found, outline};
use nalgebra::{
    DMatrix, Isometry3, Matrix3, Matrix6, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3, Vector6,
};

/// The pose that carries the points `from` onto `to` with the least sum of squares (Kabsch 1976); `None` for collinear points.
pub fn rigid(from: &[Point3<f64>], to: &[Point3<f64>]) -> Option<Isometry3<f64>> {
    let centre = |points: &[Point3<f64>]| points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let (a, b) = (centre(from), centre(to));
    let mixed: Matrix3<f64> = from.iter().zip(to).map(|(p, q)| (q.coords - b) * (p.coords - a).transpose()).sum();
    let svd = mixed.svd(true, true);
    if svd.singular_values[1] < 1e-9 * svd.singular_values[0].max(1e-300) {
        return None;
    }
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Some(Isometry3::from_parts(Translation3::from(b - rotation * a), rotation))
}

/// A marker's corners in space, in the left camera's frame, mm.
pub fn triangulated(camera: &StereoCamera, left: &Found, right: &Found) -> Option<[Point3<f64>; 4]> {
    let mut points = [Point3::origin(); 4];
    for (point, (l, r)) in points.iter_mut().zip(left.corners.iter().zip(&right.corners)) {
        *point = camera.triangulate(*l, *r)?;
    }
    Some(points)
}

/// The pose of a marker from its triangulated corners.
pub fn from_points(points: &[Point3<f64>; 4], size_mm: f64) -> Option<Isometry3<f64>> {
    rigid(&outline(size_mm).map(|c| Point3::new(c.x, c.y, 0.0)), points)
}

/// Both poses of a marker that one picture's corners allow, the better one first: a flat marker, and the same one tipped over about
/// the line of sight (Schweighofer and Pinz 2006).
pub fn from_one_picture(camera: &StereoCamera, side: Side, found: &Found, size_mm: f64) -> Vec<Isometry3<f64>> {
    let Some(first) = homography_pose(&found.directions(camera.lens(side)), size_mm) else { return Vec::new() };
    let to_left = camera.from_left(side).inverse();
    let mut poses: Vec<(f64, Isometry3<f64>)> = Vec::new();
    for start in [first, tipped_over(&first)] {
        poses.extend(to_corners(camera, &[(side, found)], &(to_left * start), size_mm));
    }
    poses.sort_by(|a, b| a.0.total_cmp(&b.0));
    poses.into_iter().map(|(_, pose)| pose).collect()
}

/// The pose whose plane is mirrored at the plane across the line of sight: where flat markers' poses are confused.
pub fn tipped_over(pose: &Isometry3<f64>) -> Isometry3<f64> {
    let sight = pose.translation.vector.normalize();
    let normal = pose.rotation * Vector3::z();
    let mirrored = sight * (2.0 * normal.dot(&sight)) - normal;
    let turn = UnitQuaternion::rotation_between(&normal, &mirrored).unwrap_or_default();
    Isometry3::from_parts(pose.translation, turn * pose.rotation)
}

/// Moves a pose until the marker's corners lie on those found; root mean square distance in px and the pose.
pub fn to_corners(
    camera: &StereoCamera,
    found: &[(Side, &Found)],
    start: &Isometry3<f64>,
    size_mm: f64,
) -> Option<(f64, Isometry3<f64>)> {
    let sum = |pose: &Isometry3<f64>| {
        let mut total = (0.0, Matrix6::zeros(), Vector6::zeros());
        for (side, found) in found {
            for (model, seen) in outline(size_mm).iter().zip(&found.corners) {
                let (pixel, slope) = look(camera, *side, pose, *model)?;
                let miss = seen - pixel;
                total.0 += miss.norm_squared();
                total.1 += slope.transpose() * slope;
                total.2 += slope.transpose() * miss;
            }
        }
        Some(total)
    };
    let mut pose = *start;
    let mut damping = 1e-3;
    let mut now = sum(&pose)?;
    for _ in 0..60 {
        let damped = now.1 + Matrix6::from_diagonal(&now.1.diagonal()) * damping;
        let next = nudge(&pose, &damped.cholesky()?.solve(&now.2));
        match sum(&next) {
            Some(better) if better.0 <= now.0 => {
                let done = now.0 - better.0 < 1e-9 * now.0;
                (pose, now, damping) = (next, better, damping / 5.0);
                if done {
                    break;
                }
            }
            _ if damping > 1e9 => break,
            _ => damping *= 8.0,
        }
    }
    Some(((now.0 / (4 * found.len()) as f64).sqrt(), pose))
}

/// Pose in the picture's own camera frame from four directions, through the homography from the marker's plane (Zhang 2000).
fn homography_pose(directions: &[Vector2<f64>; 4], size_mm: f64) -> Option<Isometry3<f64>> {
    let mut rows = DMatrix::zeros(9, 9);
    for (k, (p, d)) in outline(1.0).iter().zip(directions).enumerate() {
        let at = [p.x, p.y, 1.0];
        for j in 0..3 {
            rows[(2 * k, j)] = at[j];
            rows[(2 * k, 6 + j)] = -d.x * at[j];
            rows[(2 * k + 1, 3 + j)] = at[j];
            rows[(2 * k + 1, 6 + j)] = -d.y * at[j];
        }
    }
    let svd = rows.svd(false, true);
    let v_t = svd.v_t?;
    let least = svd.singular_values.imin();
    let h = Matrix3::from_fn(|i, j| v_t[(least, 3 * i + j)]);
    let h = if h[(2, 2)] < 0.0 { -h } else { h };
    let (x, y) = (h.column(0).into_owned(), h.column(1).into_owned());
    let scale = (x.norm() * y.norm()).sqrt();
    let turn = Matrix3::from_columns(&[x / scale, y / scale, x.cross(&y) / (scale * scale)]);
    let svd = turn.svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Some(Isometry3::from_parts(Translation3::from(h.column(2) / scale * size_mm), rotation))
}
