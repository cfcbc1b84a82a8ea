//! Vectors and poses in files, as rows of numbers.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

type Rows = [[f64; 4]; 3];

fn to_rows(pose: &Isometry3<f64>) -> Rows {
    let m = pose.to_homogeneous();
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

fn from_rows(rows: &Rows) -> Isometry3<f64> {
    let turn = Rotation3::from_matrix(&Matrix3::from_fn(|i, j| rows[i][j]));
    let at = Translation3::new(rows[0][3], rows[1][3], rows[2][3]);
    Isometry3::from_parts(at, UnitQuaternion::from_rotation_matrix(&turn))
}

/// Writes and reads a value through a plain one.
macro_rules! through {
    ($name:ident, $value:ty, $plain:ty, $to:expr, $from:expr) => {
        pub(super) mod $name {
            use super::*;

            pub fn serialize<S: Serializer>(value: &$value, s: S) -> Result<S::Ok, S::Error> {
                let to: fn(&$value) -> $plain = $to;
                to(value).serialize(s)
            }

            pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<$value, D::Error> {
                let from: fn($plain) -> $value = $from;
                <$plain>::deserialize(d).map(from)
            }
        }
    };
}

through!(vector, Vector3<f64>, [f64; 3], |v| (*v).into(), Vector3::from);
through!(direction, Option<Vector3<f64>>, Option<[f64; 3]>, |v| v.map(Into::into), |v| v.map(Vector3::from));
through!(point, Option<Point3<f64>>, Option<[f64; 3]>, |v| v.map(|p| p.coords.into()), |v| v.map(Point3::from));
through!(
    matrix,
    Matrix3<f64>,
    [[f64; 3]; 3],
    |m| std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)])),
    |rows| Matrix3::from_fn(|i, j| rows[i][j])
);
through!(pose, Isometry3<f64>, Rows, to_rows, |rows| from_rows(&rows));
through!(maybe_pose, Option<Isometry3<f64>>, Option<Rows>, |p| p.as_ref().map(to_rows), |rows| {
    rows.as_ref().map(from_rows)
});
