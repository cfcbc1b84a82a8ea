//! Lenses, the cameras' relative pose and the board's poses, adjusted to all corners at once.

use super::super::camera::{Lens, Side, StereoCamera};
use super::super::fit::nudge;
use super::super::lm::minimise;
use super::Corner;
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector6,
};

/// What the corners say.
pub(super) struct Fit {
    pub camera: StereoCamera,
    pub rms_px: f64,
    pub standard_errors: [[f64; 8]; 2],
    pub pair_rms_px: Vec<f64>,
}

/// Numbers before the board's poses: two lenses, one relative pose.
const CAMERAS: usize = 8 + 8 + 6;

/// `None` when no cameras explain the corners.
pub(super) fn adjust(corners: &[Corner], image_size: [usize; 2], pairs: usize) -> Option<Fit> {
    let centre = Vector2::new((image_size[0] as f64 - 1.0) / 2.0, (image_size[1] as f64 - 1.0) / 2.0);
    let mut lenses = Vec::new();
    let mut boards = Vec::new();
    for side in Side::BOTH {
        let maps: Vec<Matrix3<f64>> =
            (0..pairs).map(|k| homography(corners, k, side, centre)).collect::<Option<_>>()?;
        let f = focal(&maps, image_size);
        lenses.push(Lens { fx: f, fy: f, cx: centre.x, cy: centre.y, k1: 0.0, k2: 0.0, p1: 0.0, p2: 0.0 });
        boards.push(maps.iter().map(|h| board_pose(h, f)).collect::<Option<Vec<_>>>()?);
    }
    // The pair whose two poses agree best with the others' says first how the cameras stand to each other.
    let between: Vec<Isometry3<f64>> = (0..pairs).map(|k| boards[1][k] * boards[0][k].inverse()).collect();
    let off = |a: &Isometry3<f64>| between.iter().map(|b| (a.rotation.angle_to(&b.rotation)).min(0.2)).sum::<f64>();
    let first = *between.iter().min_by(|a, b| off(a).total_cmp(&off(b)))?;
    let start = [&lenses[0], &lenses[1]].map(numbers).concat();
    let start =
        DVector::from_iterator(CAMERAS + 6 * pairs, start.into_iter().chain(std::iter::repeat_n(0.0, 6 + 6 * pairs)));
    let pose = |x: &DVector<f64>, at: usize, from: &Isometry3<f64>| {
        nudge(from, &Vector6::from_iterator(x.rows(at, 6).iter().copied()))
    };
    let residuals = |x: &DVector<f64>| {
        let lenses = [lens(x, 0), lens(x, 8)];
        let right = pose(x, 16, &first);
        let poses: Vec<_> = (0..pairs).map(|k| pose(x, CAMERAS + 6 * k, &boards[0][k])).collect();
        let mut out = DVector::zeros(2 * corners.len());
        for (k, c) in corners.iter().enumerate() {
            let mut p = poses[c.pair] * Point3::new(c.model.x, c.model.y, 0.0);
            if c.side == Side::Right {
                p = right * p;
            }
            if p.z < 1.0 {
                return None;
            }
            let miss = lenses[c.side as usize].pixel(Vector2::new(p.x / p.z, p.y / p.z)) - c.pixel;
            out.fixed_rows_mut::<2>(2 * k).copy_from(&miss);
        }
        Some(out)
    };
    let lens_steps = [1e-3, 1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-7, 1e-7];
    let pose_steps = [1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6];
    let steps = lens_steps.into_iter().chain(lens_steps).chain(pose_steps.into_iter().cycle().take(6 + 6 * pairs));
    let steps = DVector::from_iterator(CAMERAS + 6 * pairs, steps);
    let found = minimise(start, &steps, residuals)?;
    let x = &found.parameters;
    let left_to_right = pose(x, 16, &first);
    let camera = StereoCamera { image_size, left: lens(x, 0), right: lens(x, 8), left_to_right };
    let rest = residuals(x)?;
    let rms = |part: &dyn Fn(&Corner) -> bool| {
        let chosen = corners.iter().enumerate().filter(|(_, c)| part(c));
        let (sum, count) =
            chosen.fold((0.0, 0), |(sum, n), (k, _)| (sum + rest.fixed_rows::<2>(2 * k).norm_squared(), n + 1));
        (sum / f64::from(count.max(1))).sqrt()
    };
    let pair_rms_px = (0..pairs).map(|k| rms(&|c| c.pair == k)).collect();
    let freedom = (rest.len() as f64 - x.len() as f64).max(1.0);
    let errors = standard_errors(&found.normal, found.cost / freedom);
    Some(Fit { camera, rms_px: rms(&|_| true), standard_errors: errors, pair_rms_px })
}

fn standard_errors(normal: &DMatrix<f64>, variance: f64) -> [[f64; 8]; 2] {
    let inverse = normal.clone().cholesky().map(|c| c.inverse());
    let error = |k: usize| inverse.as_ref().map_or(f64::INFINITY, |m| (m[(k, k)] * variance).sqrt());
    [std::array::from_fn(error), std::array::from_fn(|k| error(8 + k))]
}

fn numbers(l: &Lens) -> [f64; 8] {
    [l.fx, l.fy, l.cx, l.cy, l.k1, l.k2, l.p1, l.p2]
}

fn lens(x: &DVector<f64>, at: usize) -> Lens {
    let n = |k: usize| x[at + k];
    Lens { fx: n(0), fy: n(1), cx: n(2), cy: n(3), k1: n(4), k2: n(5), p1: n(6), p2: n(7) }
}

/// The map from the board's plane to a picture, its origin moved to the picture's centre.
fn homography(corners: &[Corner], pair: usize, side: Side, centre: Vector2<f64>) -> Option<Matrix3<f64>> {
    let chosen: Vec<&Corner> = corners.iter().filter(|c| c.pair == pair && c.side == side).collect();
    let scale = centre.norm();
    let mut normal = DMatrix::zeros(9, 9);
    for c in &chosen {
        let q = (c.pixel - centre) / scale;
        let at = [c.model.x / 100.0, c.model.y / 100.0, 1.0];
        for (axis, v) in [q.x, q.y].into_iter().enumerate() {
            let mut row = DVector::zeros(9);
            for j in 0..3 {
                row[3 * axis + j] = at[j];
                row[6 + j] = -v * at[j];
            }
            normal.ger(1.0, &row, &row, 1.0);
        }
    }
    if chosen.len() < 8 {
        return None;
    }
    let eigen = normal.symmetric_eigen();
    let least = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let back = Matrix3::from_diagonal(&nalgebra::Vector3::new(scale, scale, 1.0));
    let unit = Matrix3::from_diagonal(&nalgebra::Vector3::new(0.01, 0.01, 1.0));
    let h = back * Matrix3::from_fn(|i, j| least[3 * i + j]) * unit;
    Some(if h[(2, 2)] < 0.0 { -h } else { h })
}

/// The focal length under which the boards' axes are orthogonal and equally long (Zhang 2000), the principal point at the centre.
fn focal(maps: &[Matrix3<f64>], image_size: [usize; 2]) -> f64 {
    let (mut top, mut bottom) = (0.0, 0.0);
    for h in maps {
        let h = h / h.norm();
        let (a, b) = (h.column(0), h.column(1));
        let conditions = [
            (a[0] * b[0] + a[1] * b[1], a[2] * b[2]),
            (a[0] * a[0] + a[1] * a[1] - b[0] * b[0] - b[1] * b[1], a[2] * a[2] - b[2] * b[2]),
        ];
        for (u, v) in conditions {
            top -= u * v;
            bottom += u * u;
        }
    }
    let width = image_size[0] as f64;
    let f = (bottom / top).max(0.0).sqrt();
    if f.is_finite() && f > 0.2 * width && f < 20.0 * width { f } else { width }
}

fn board_pose(h: &Matrix3<f64>, f: f64) -> Option<Isometry3<f64>> {
    let h = Matrix3::from_diagonal(&nalgebra::Vector3::new(1.0 / f, 1.0 / f, 1.0)) * h;
    let (x, y) = (h.column(0).into_owned(), h.column(1).into_owned());
    let scale = (x.norm() * y.norm()).sqrt();
    let svd = Matrix3::from_columns(&[x / scale, y / scale, x.cross(&y) / (scale * scale)]).svd(true, true);
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(svd.u? * svd.v_t?));
    Some(Isometry3::from_parts(Translation3::from(h.column(2) / scale), turn))
}
