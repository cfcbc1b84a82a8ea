//! Frames of reference as types: a point of one cannot be taken for a point of another, and transforms compose in the
//! right order or not at all.
//!
//! ```
//! use parfocal::calibration::frames::{Image, Mic, MicStar, Point, Ref, Transform};
//! # fn f(ref_from_mic: Transform<Mic, Ref>, mic_from_star: Transform<MicStar, Mic>, star_from_image: Transform<Image, MicStar>, p: Point<Image>) {
//! let ref_from_image: Transform<Image, Ref> = ref_from_mic * mic_from_star * star_from_image;
//! let in_ref: Point<Ref> = ref_from_image * p;
//! # }
//! ```
//!
//! The wrong order does not compile:
//!
//! ```compile_fail
//! use parfocal::calibration::frames::{Image, Mic, MicStar, Ref, Transform};
//! # fn f(ref_from_mic: Transform<Mic, Ref>, mic_from_star: Transform<MicStar, Mic>) {
//! let wrong = mic_from_star * ref_from_mic;
//! # }
//! ```
//!
//! nor does a transform of another frame's point:
//!
//! ```compile_fail
//! use parfocal::calibration::frames::{Image, Mic, Point, Ref, Transform};
//! # fn f(ref_from_mic: Transform<Mic, Ref>, p: Point<Image>) {
//! let wrong = ref_from_mic * p;
//! # }
//! ```

use nalgebra::{Matrix3, Matrix4, Vector3};
use std::fmt;
use std::marker::PhantomData;
use std::ops::{Add, Mul, Sub};

macro_rules! frames {
    ($($(#[$doc:meta])* $name:ident),* $(,)?) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {}
    )*};
}

frames! {
    /// The task frame, µm; equals [`Mic`] when the microscope's axes are at their origin.
    Ref,
    /// Moves with the microscope, µm.
    Mic,
    /// [`Mic`] as the default objective at zoom 1 sees it, µm.
    MicStar,
    /// Origin at the picture's centre in the focal plane; x right and y down in px of the full sensor, z in µm.
    Image,
    /// A manipulator's joints, µm.
    Man,
    /// Origin at a pipette's tip, x along its axis, µm.
    Pip,
}

/// A place in a frame, in the frame's unit.
pub struct Point<F> {
    /// x, y, z.
    pub coordinates: Vector3<f64>,
    frame: PhantomData<fn() -> F>,
}

/// A displacement, or a velocity a second, in a frame.
pub struct Displacement<F> {
    /// x, y, z.
    pub coordinates: Vector3<f64>,
    frame: PhantomData<fn() -> F>,
}

/// An affine map of coordinates in `From` to coordinates in `To`.
pub struct Transform<From, To> {
    linear: Matrix3<f64>,
    shift: Vector3<f64>,
    frames: PhantomData<fn(From) -> To>,
}

/// Derives would ask the frames for the traits.
macro_rules! plain_value {
    ($($name:ident<$($frame:ident),+> { $($field:ident),+ })*) => {$(
        impl<$($frame),+> Clone for $name<$($frame),+> {
            fn clone(&self) -> Self {
                *self
            }
        }
        impl<$($frame),+> Copy for $name<$($frame),+> {}
        impl<$($frame),+> PartialEq for $name<$($frame),+> {
            fn eq(&self, other: &Self) -> bool {
                $(self.$field == other.$field)&&+
            }
        }
        impl<$($frame),+> fmt::Debug for $name<$($frame),+> {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.debug_struct(stringify!($name))$(.field(stringify!($field), &self.$field))+.finish()
            }
        }
    )*};
}
plain_value! {
    Point<F> { coordinates }
    Displacement<F> { coordinates }
    Transform<From, To> { linear, shift }
}

impl<F> Point<F> {
    /// The point at x, y, z.
    pub fn new(x: f64, y: f64, z: f64) -> Self {
        Vector3::new(x, y, z).into()
    }
}

impl<F> Displacement<F> {
    /// The displacement x, y, z.
    pub fn new(x: f64, y: f64, z: f64) -> Self {
        Vector3::new(x, y, z).into()
    }
}

impl<F> From<Vector3<f64>> for Point<F> {
    fn from(coordinates: Vector3<f64>) -> Self {
        Self { coordinates, frame: PhantomData }
    }
}

impl<F> From<Vector3<f64>> for Displacement<F> {
    fn from(coordinates: Vector3<f64>) -> Self {
        Self { coordinates, frame: PhantomData }
    }
}

impl<F> Sub for Point<F> {
    type Output = Displacement<F>;

    fn sub(self, other: Self) -> Displacement<F> {
        (self.coordinates - other.coordinates).into()
    }
}

impl<F> Add<Displacement<F>> for Point<F> {
    type Output = Self;

    fn add(self, by: Displacement<F>) -> Self {
        (self.coordinates + by.coordinates).into()
    }
}

impl<F> Mul<Displacement<F>> for f64 {
    type Output = Displacement<F>;

    fn mul(self, d: Displacement<F>) -> Displacement<F> {
        (self * d.coordinates).into()
    }
}

impl<A, B> Transform<A, B> {
    /// p ↦ linear·p + shift; `None` when it cannot be inverted.
    pub fn new(linear: Matrix3<f64>, shift: Vector3<f64>) -> Option<Self> {
        let whole = linear.iter().chain(shift.iter()).all(|v| v.is_finite());
        (whole && linear.is_invertible()).then_some(Self { linear, shift, frames: PhantomData })
    }

    /// p ↦ p + shift.
    pub fn translation(shift: Vector3<f64>) -> Self {
        Self { linear: Matrix3::identity(), shift, frames: PhantomData }
    }

    /// Reads a homogeneous matrix, row-major; `None` unless it ends with 0 0 0 1 and can be inverted.
    pub fn from_rows(rows: &[[f64; 4]; 4]) -> Option<Self> {
        let linear = Matrix3::from_fn(|r, c| rows[r][c]);
        let last = rows[3] == [0.0, 0.0, 0.0, 1.0];
        last.then(|| Self::new(linear, Vector3::from_fn(|r, _| rows[r][3]))).flatten()
    }

    /// The homogeneous 4x4 matrix, row-major.
    pub fn to_rows(&self) -> [[f64; 4]; 4] {
        let m = self.to_homogeneous();
        std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]))
    }

    /// The homogeneous 4x4 matrix.
    pub fn to_homogeneous(&self) -> Matrix4<f64> {
        let mut m = self.linear.to_homogeneous();
        m.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.shift);
        m
    }

    /// The linear part: what it does to displacements.
    pub fn linear(&self) -> &Matrix3<f64> {
        &self.linear
    }

    /// Where it sends the origin.
    pub fn shift(&self) -> &Vector3<f64> {
        &self.shift
    }

    /// The way back.
    ///
    /// # Panics
    /// Never for a transform made by [`Self::new`], [`Self::from_rows`] or composed of such.
    pub fn inverse(&self) -> Transform<B, A> {
        let linear = self.linear.try_inverse().expect("transforms are invertible by construction");
        Transform { linear, shift: -(linear * self.shift), frames: PhantomData }
    }
}

/// `outer * inner`: first `inner`, then `outer`.
impl<A, B, C> Mul<Transform<A, B>> for Transform<B, C> {
    type Output = Transform<A, C>;

    fn mul(self, inner: Transform<A, B>) -> Transform<A, C> {
        Transform {
            linear: self.linear * inner.linear,
            shift: self.linear * inner.shift + self.shift,
            frames: PhantomData,
        }
    }
}

impl<A, B> Mul<Point<A>> for Transform<A, B> {
    type Output = Point<B>;

    fn mul(self, p: Point<A>) -> Point<B> {
        (self.linear * p.coordinates + self.shift).into()
    }
}

/// Displacements and velocities see the linear part only.
impl<A, B> Mul<Displacement<A>> for Transform<A, B> {
    type Output = Displacement<B>;

    fn mul(self, d: Displacement<A>) -> Displacement<B> {
        (self.linear * d.coordinates).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn matrix() -> impl Strategy<Value = (Matrix3<f64>, Vector3<f64>)> {
        proptest::array::uniform12(-10.0..10.0f64)
            .prop_map(|v| (Matrix3::from_column_slice(&v[..9]), Vector3::from_column_slice(&v[9..])))
            .prop_filter("well conditioned", |(m, _)| m.determinant().abs() > 1.0)
    }

    proptest! {
        #[test]
        fn composition_is_the_product_of_homogeneous_matrices(a in matrix(), b in matrix(), p in proptest::array::uniform3(-1e3..1e3f64)) {
            let outer = Transform::<Mic, Ref>::new(a.0, a.1).unwrap();
            let inner = Transform::<MicStar, Mic>::new(b.0, b.1).unwrap();
            let both = outer * inner;
            let product = outer.to_homogeneous() * inner.to_homogeneous();
            prop_assert!((both.to_homogeneous() - product).abs().max() < 1e-9);
            let p = Point::<MicStar>::from(Vector3::from(p));
            let there = both * p;
            prop_assert!((there.coordinates - (outer * (inner * p)).coordinates).norm() < 1e-6);
            prop_assert!((both.inverse() * there - p).coordinates.norm() < 1e-6);
        }
    }

    #[test]
    fn rows_are_read_as_they_are_written_and_singular_ones_refused() {
        let rows = [[1.0, 2.0, 0.0, 4.0], [0.0, 1.0, 0.5, 5.0], [0.0, 0.0, 2.0, 6.0], [0.0, 0.0, 0.0, 1.0]];
        assert_eq!(Transform::<Man, Ref>::from_rows(&rows).unwrap().to_rows(), rows);
        assert!(Transform::<Man, Ref>::from_rows(&[[0.0; 4]; 4]).is_none());
        assert!(Transform::<Man, Ref>::new(Matrix3::repeat(1.0), Vector3::zeros()).is_none());
    }
}
