//! The stereo camera: two lenses, and where the right one is seen from the left.

use super::Millimetres;
use nalgebra::{Isometry3, Matrix2, Matrix2x3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector2};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Which picture of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The left one, whose camera's frame poses are given in.
    Left,
    /// The right one.
    Right,
}

impl Side {
    /// Left, then right.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];
}

impl std::fmt::Display for Side {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(if *self == Self::Left { "left" } else { "right" })
    }
}

/// Two rows, a column for each of a lens's numbers.
pub type Matrix2x8 = nalgebra::SMatrix<f64, 2, 8>;

/// A pinhole lens with radial and tangential distortion (Brown 1966). Focal lengths and principal point in px,
/// (0, 0) the centre of the top-left pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lens {
    /// Focal length along x, px.
    pub fx: f64,
    /// Focal length along y, px.
    pub fy: f64,
    /// Principal point's column, px.
    pub cx: f64,
    /// Principal point's row, px.
    pub cy: f64,
    /// Radial distortion, r² term.
    #[serde(default)]
    pub k1: f64,
    /// Radial distortion, r⁴ term.
    #[serde(default)]
    pub k2: f64,
    /// Tangential distortion, y term.
    #[serde(default)]
    pub p1: f64,
    /// Tangential distortion, x term.
    #[serde(default)]
    pub p2: f64,
}

impl Lens {
    /// The pixel of the direction (x, y, 1) in the camera's frame.
    pub fn pixel(&self, direction: Vector2<f64>) -> Vector2<f64> {
        let d = self.bend(direction);
        Vector2::new(self.fx * d.x + self.cx, self.fy * d.y + self.cy)
    }

    /// The pixel of a point in the camera's frame and the pixel's change with the point; `None` behind the camera.
    pub fn project(&self, p: &Point3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        if p.z <= 1e-9 {
            return None;
        }
        let d = Vector2::new(p.x / p.z, p.y / p.z);
        let perspective = Matrix2x3::new(1.0, 0.0, -d.x, 0.0, 1.0, -d.y) / p.z;
        let scale = Matrix2::new(self.fx, 0.0, 0.0, self.fy);
        Some((self.pixel(d), scale * self.bend_slope(d) * perspective))
    }

    /// The direction (x, y, 1) that a pixel looks in, by Newton's method.
    pub fn direction(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        let goal = Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy);
        let mut d = goal;
        for _ in 0..20 {
            let miss = goal - self.bend(d);
            let Some(inverse) = self.bend_slope(d).try_inverse() else { break };
            d += inverse * miss;
            if miss.norm() < 1e-13 {
                break;
            }
        }
        d
    }

    /// All its numbers in the order of the fields.
    pub fn numbers(&self) -> [f64; 8] {
        [self.fx, self.fy, self.cx, self.cy, self.k1, self.k2, self.p1, self.p2]
    }

    /// A lens of these numbers, in the order of the fields.
    pub fn from_numbers([fx, fy, cx, cy, k1, k2, p1, p2]: [f64; 8]) -> Self {
        Self { fx, fy, cx, cy, k1, k2, p1, p2 }
    }

    /// The change of [`Self::pixel`] with each of the lens's numbers.
    pub fn slope_by_numbers(&self, direction: Vector2<f64>) -> Matrix2x8 {
        let (x, y, d) = (direction.x, direction.y, self.bend(direction));
        let r2 = x * x + y * y;
        let (a, b) = (self.fx, self.fy);
        Matrix2x8::from_row_slice(
            &[
                [d.x, 0.0, 1.0, 0.0, a * x * r2, a * x * r2 * r2, 2.0 * a * x * y, a * (r2 + 2.0 * x * x)],
                [0.0, d.y, 0.0, 1.0, b * y * r2, b * y * r2 * r2, b * (r2 + 2.0 * y * y), 2.0 * b * x * y],
            ]
            .concat(),
        )
    }

    fn bend(&self, d: Vector2<f64>) -> Vector2<f64> {
        let (x, y) = (d.x, d.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * self.k2);
        Vector2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    fn bend_slope(&self, d: Vector2<f64>) -> Matrix2<f64> {
        let (x, y) = (d.x, d.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * self.k2);
        let growth = 2.0 * (self.k1 + 2.0 * r2 * self.k2);
        let mixed = growth * x * y + 2.0 * (self.p1 * x + self.p2 * y);
        Matrix2::new(
            radial + growth * x * x + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            mixed,
            mixed,
            radial + growth * y * y + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        )
    }
}

/// Why a stereo camera cannot be used.
#[derive(Debug, Error, PartialEq)]
pub enum StereoError {
    /// Not the file's form.
    #[error("the stereo camera's file is not of the form asked for: {0}")]
    Syntax(String),
    /// A number that cannot be.
    #[error("the stereo camera's {field} is {value}: {why}")]
    Value {
        /// Which.
        field: String,
        /// What it is.
        value: f64,
        /// What it has to be.
        why: &'static str,
    },
    /// R does not turn, or mirrors.
    #[error(
        "the stereo camera's R is no rotation (it is off by {0:.4}): give the matrix of p_right = R·p_left + t, row by row"
    )]
    NoRotation(f64),
}

/// Two cameras held rigidly: p_right = R·p_left + t.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "StereoFile", into = "StereoFile")]
pub struct StereoCamera {
    /// Columns and rows of each picture.
    pub image_size: [usize; 2],
    /// The left lens.
    pub left: Lens,
    /// The right lens.
    pub right: Lens,
    /// Left camera's frame to right camera's frame, mm.
    pub left_to_right: Isometry3<f64>,
}

/// The file `stereo.json`, lengths in metres.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StereoFile {
    image_size: [usize; 2],
    left: Lens,
    right: Lens,
    #[serde(rename = "R")]
    r: [[f64; 3]; 3],
    t_m: [f64; 3],
}

impl StereoCamera {
    /// Reads `stereo.json`.
    ///
    /// # Errors
    /// [`StereoError`], naming the field.
    pub fn from_json(text: &str) -> Result<Self, StereoError> {
        let file: StereoFile = serde_json::from_str(text).map_err(|e| StereoError::Syntax(e.to_string()))?;
        Self::try_from(file)
    }

    /// One of the lenses.
    pub fn lens(&self, side: Side) -> &Lens {
        match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        }
    }

    /// Left camera's frame to that side's frame, mm.
    pub fn from_left(&self, side: Side) -> Isometry3<f64> {
        match side {
            Side::Left => Isometry3::identity(),
            Side::Right => self.left_to_right,
        }
    }

    /// Distance between the two cameras.
    pub fn baseline(&self) -> Millimetres {
        Millimetres(self.left_to_right.translation.vector.norm())
    }

    /// The point in the left camera's frame, mm, that lies nearest to both pixels' rays; `None` for parallel rays. Its z is negative
    /// when the rays meet behind the cameras, as they do when left and right are swapped.
    pub fn triangulate(&self, left: Vector2<f64>, right: Vector2<f64>) -> Option<Point3<f64>> {
        let to_left = self.left_to_right.inverse();
        let a = self.left.direction(left).push(1.0).normalize();
        let b = to_left.rotation * self.right.direction(right).push(1.0).normalize();
        let from = to_left.translation.vector;
        let along = a.dot(&b);
        let parallel = 1.0 - along * along;
        if parallel < 1e-12 {
            return None;
        }
        let s = (from.dot(&a) - along * from.dot(&b)) / parallel;
        let t = (along * from.dot(&a) - from.dot(&b)) / parallel;
        Some(Point3::from((a * s + from + b * t) / 2.0))
    }
}

impl TryFrom<StereoFile> for StereoCamera {
    type Error = StereoError;

    fn try_from(file: StereoFile) -> Result<Self, StereoError> {
        for (name, lens) in [("left", &file.left), ("right", &file.right)] {
            for (field, value) in [("fx", lens.fx), ("fy", lens.fy)] {
                if !(value.is_finite() && value > 0.0) {
                    let why = "a focal length is a number of pixels above 0";
                    return Err(StereoError::Value { field: format!("{name}.{field}"), value, why });
                }
            }
            let rest =
                [("cx", lens.cx), ("cy", lens.cy), ("k1", lens.k1), ("k2", lens.k2), ("p1", lens.p1), ("p2", lens.p2)];
            if let Some((field, value)) = rest.into_iter().find(|(_, v)| !v.is_finite()) {
                return Err(StereoError::Value { field: format!("{name}.{field}"), value, why: "give a number" });
            }
        }
        let [w, h] = file.image_size;
        if w == 0 || h == 0 {
            let why = "give [width, height] in pixels";
            return Err(StereoError::Value { field: "image_size".into(), value: 0.0, why });
        }
        let r = Matrix3::from_fn(|i, j| file.r[i][j]);
        let off = (r * r.transpose() - Matrix3::identity()).norm();
        if !(off < 1e-2 && r.determinant() > 0.0) {
            return Err(StereoError::NoRotation(off));
        }
        let length = file.t_m.iter().map(|v| v * v).sum::<f64>().sqrt();
        if !(length > 1e-4 && length < 10.0) {
            let why = "the distance between the cameras is in metres, between 0.0001 and 10";
            return Err(StereoError::Value { field: "t_m".into(), value: length, why });
        }
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&r));
        let t = file.t_m.map(|v| v * 1000.0);
        let left_to_right = Isometry3::from_parts(Translation3::new(t[0], t[1], t[2]), rotation);
        Ok(Self { image_size: file.image_size, left: file.left, right: file.right, left_to_right })
    }
}

impl From<StereoCamera> for StereoFile {
    fn from(camera: StereoCamera) -> Self {
        let r = camera.left_to_right.rotation.to_rotation_matrix();
        let t = camera.left_to_right.translation.vector / 1000.0;
        Self {
            image_size: camera.image_size,
            left: camera.left,
            right: camera.right,
            r: std::array::from_fn(|i| std::array::from_fn(|j| r[(i, j)])),
            t_m: [t.x, t.y, t.z],
        }
    }
}
