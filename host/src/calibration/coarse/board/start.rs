//! A first idea of lenses and poses, from the maps between the board's plane and each picture (Zhang 2000).

use super::super::camera::{Lens, Side};
use super::Corner;
use nalgebra::{Isometry3, Matrix3, Rotation3, SMatrix, SVector, Translation3, UnitQuaternion, Vector2, Vector3};

/// Lenses without distortion and poses, good to a few per cent.
pub(super) struct Guess {
    pub lenses: [Lens; 2],
    pub right: Isometry3<f64>,
    pub boards: Vec<Isometry3<f64>>,
}

/// `None` when a pair's corners do not determine its map.
pub(super) fn guess(corners: &[Corner], image_size: [usize; 2], pairs: usize) -> Option<Guess> {
    let centre = Vector2::new((image_size[0] as f64 - 1.0) / 2.0, (image_size[1] as f64 - 1.0) / 2.0);
    let one = |side: Side| {
        let maps: Vec<Matrix3<f64>> =
            (0..pairs).map(|k| homography(corners, k, side, centre)).collect::<Option<_>>()?;
        let f = focal(&maps, image_size);
        let boards = maps.iter().map(|h| board_pose(h, f)).collect::<Option<Vec<_>>>()?;
        Some((Lens::from_numbers([f, f, centre.x, centre.y, 0.0, 0.0, 0.0, 0.0]), boards))
    };
    let ((left, boards), (right, seen_right)) = (one(Side::Left)?, one(Side::Right)?);
    // The pair whose two poses agree best with the others' says first how the cameras stand to each other.
    let between: Vec<Isometry3<f64>> = boards.iter().zip(&seen_right).map(|(l, r)| r * l.inverse()).collect();
    let off = |a: &Isometry3<f64>| between.iter().map(|b| (a.rotation.angle_to(&b.rotation)).min(0.2)).sum::<f64>();
    let first = *between.iter().min_by(|a, b| off(a).total_cmp(&off(b)))?;
    Some(Guess { lenses: [left, right], right: first, boards })
}

/// The map from the board's plane to a picture, its origin moved to the picture's centre.
fn homography(corners: &[Corner], pair: usize, side: Side, centre: Vector2<f64>) -> Option<Matrix3<f64>> {
    let scale = centre.norm();
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    let mut count = 0;
    for c in corners.iter().filter(|c| c.pair == pair && c.side == side) {
        let q = (c.pixel - centre) / scale;
        let at = [c.model.x / 100.0, c.model.y / 100.0, 1.0];
        for (axis, v) in [q.x, q.y].into_iter().enumerate() {
            let mut row = SVector::<f64, 9>::zeros();
            for j in 0..3 {
                row[3 * axis + j] = at[j];
                row[6 + j] = -v * at[j];
            }
            normal += row * row.transpose();
        }
        count += 1;
    }
    if count < 8 {
        return None;
    }
    let eigen = normal.symmetric_eigen();
    let least = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let back = Matrix3::from_diagonal(&Vector3::new(scale, scale, 1.0));
    let unit = Matrix3::from_diagonal(&Vector3::new(0.01, 0.01, 1.0));
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
    let h = Matrix3::from_diagonal(&Vector3::new(1.0 / f, 1.0 / f, 1.0)) * h;
    let (x, y) = (h.column(0).into_owned(), h.column(1).into_owned());
    let scale = (x.norm() * y.norm()).sqrt();
    let svd = Matrix3::from_columns(&[x / scale, y / scale, x.cross(&y) / (scale * scale)]).svd(true, true);
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(svd.u? * svd.v_t?));
    Some(Isometry3::from_parts(Translation3::from(h.column(2) / scale), turn))
}
