//! The maps that points can be fitted with, and least squares for each.
//!
//! Every model answers with a [`Fit`]: the map, and the leverage of any point, that is how much of the noise of the
//! points used reaches the map there: Var(prediction) = h·σ² (Hoaglin & Welsch, The hat matrix, 1978).

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// Three points before and after, which have frames of their own.
type Frames = ([Vector3<f64>; 3], [Vector3<f64>; 3]);

/// The linear part, and what it takes from the points' spread.
type Gain<const D: usize> = (SMatrix<f64, D, D>, SMatrix<f64, D, D>);

/// y = L·x + t in D dimensions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Map<const D: usize> {
    /// L.
    pub linear: SMatrix<f64, D, D>,
    /// t.
    pub shift: SVector<f64, D>,
}

impl<const D: usize> Map<D> {
    /// L·x + t.
    #[inline]
    pub fn apply(&self, x: &SVector<f64, D>) -> SVector<f64, D> {
        self.linear * x + self.shift
    }
}

/// A least-squares fit, and how certain it is anywhere.
#[derive(Clone, Copy, Debug)]
pub struct Fit<const D: usize> {
    /// The map.
    pub map: Map<D>,
    /// Mean of the sources used.
    pub centre: SVector<f64, D>,
    /// Source displacements x from the centre add xᵀGx to the leverage.
    pub gain: SMatrix<f64, D, D>,
    /// Leverage at the centre: one over the number of points used.
    pub base: f64,
}

impl<const D: usize> Fit<D> {
    /// Leverage h of a source point.
    #[inline]
    pub fn leverage(&self, x: &SVector<f64, D>) -> f64 {
        let d = x - self.centre;
        self.base + d.dot(&(self.gain * d))
    }
}

/// A family of maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// Any linear part.
    Affine,
    /// Rotation and one scale (3-D, right-handed).
    Similarity,
    /// Rotation only (3-D, right-handed).
    Rigid,
    /// One scale, no rotation.
    ScaleOffset,
}

impl Model {
    /// Points that determine it in `D` dimensions.
    pub fn sample_size<const D: usize>(self) -> usize {
        match self {
            Self::Affine => D + 1,
            Self::Similarity | Self::Rigid => 3,
            Self::ScaleOffset => 2,
        }
    }

    /// Its free parameters in `D` dimensions.
    pub fn parameters<const D: usize>(self) -> usize {
        match self {
            Self::Affine => D * (D + 1),
            Self::Similarity => 7,
            Self::Rigid => 6,
            Self::ScaleOffset => D + 1,
        }
    }

    /// Its name, as options and files spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Affine => "affine",
            Self::Similarity => "similarity",
            Self::Rigid => "rigid",
            Self::ScaleOffset => "scale-offset",
        }
    }

    /// Least squares over the points `chosen` (indices). `None` when they do not determine the map.
    pub fn fit<const D: usize>(
        self,
        src: &[SVector<f64, D>],
        dst: &[SVector<f64, D>],
        chosen: &[usize],
    ) -> Option<Fit<D>> {
        let moments = Moments::new(src, dst, chosen);
        let (linear, gain) = match self {
            Self::Affine => moments.affine()?,
            Self::ScaleOffset => moments.scale()?,
            Self::Rigid | Self::Similarity => {
                let minimal = chosen.len() == 3;
                let frames = minimal.then(|| (three(src, chosen), three(dst, chosen)));
                moments.rotation(self == Self::Similarity, frames)?
            }
        };
        let shift = moments.to - linear * moments.from;
        Some(Fit { map: Map { linear, shift }, centre: moments.from, gain, base: 1.0 / chosen.len() as f64 })
    }
}

/// First and second moments of the chosen pairs.
struct Moments<const D: usize> {
    from: SVector<f64, D>,
    to: SVector<f64, D>,
    /// Σ x xᵀ
    xx: SMatrix<f64, D, D>,
    /// Σ y xᵀ
    yx: SMatrix<f64, D, D>,
}

impl<const D: usize> Moments<D> {
    fn new(src: &[SVector<f64, D>], dst: &[SVector<f64, D>], chosen: &[usize]) -> Self {
        let share = 1.0 / chosen.len() as f64;
        let (mut from, mut to) = (SVector::zeros(), SVector::zeros());
        for &i in chosen {
            from += src[i];
            to += dst[i];
        }
        from *= share;
        to *= share;
        let (mut xx, mut yx) = (SMatrix::zeros(), SMatrix::zeros());
        for &i in chosen {
            let (x, y) = (src[i] - from, dst[i] - to);
            // Written out: the general product's set-up costs more than these few multiplications.
            for c in 0..D {
                for r in 0..D {
                    xx[(r, c)] += x[r] * x[c];
                    yx[(r, c)] += y[r] * x[c];
                }
            }
        }
        Self { from, to, xx, yx }
    }

    fn affine(&self) -> Option<(SMatrix<f64, D, D>, SMatrix<f64, D, D>)> {
        let inverse = self.xx.try_inverse()?;
        // A determinant that is rounding alone passes the inverse; its product with the matrix gives it away.
        let error = (inverse * self.xx - SMatrix::<f64, D, D>::identity()).abs().max();
        (error < 1e-6).then(|| (self.yx * inverse, inverse))
    }

    fn scale(&self) -> Option<Gain<D>> {
        let spread = self.xx.trace();
        (spread > 0.0).then(|| {
            let identity = SMatrix::<f64, D, D>::identity();
            (identity * (self.yx.trace() / spread), identity / (spread * D as f64))
        })
    }

    /// Rotation, with one scale if asked. Three points have their own frame, which is cheaper than a decomposition.
    fn rotation(&self, scaled: bool, frames: Option<Frames>) -> Option<Gain<D>> {
        // These models exist in 3-D only; the copies below are between equal sizes.
        let xx: Matrix3<f64> = resize(&self.xx)?;
        let yx: Matrix3<f64> = resize(&self.yx)?;
        let total = xx.trace();
        let turn = match frames {
            Some((from, to)) => frame(&to)? * frame(&from)?.transpose(),
            None => kabsch(&yx)?,
        };
        let scale = if scaled { (turn.transpose() * yx).trace() / total } else { 1.0 };
        let inertia = Matrix3::identity() * total - xx;
        let inverse = inertia.try_inverse()?;
        if !(scale > 0.0) || !inverse.iter().all(|v| v.is_finite()) {
            return None;
        }
        let mut gain = (Matrix3::identity() * inverse.trace() - inverse) / 3.0;
        if scaled {
            gain += Matrix3::identity() / (3.0 * total);
        }
        Some((resize(&(turn * scale))?, resize(&gain)?))
    }
}

/// A square matrix as one of another const size, when the sizes are equal.
fn resize<const A: usize, const B: usize>(m: &SMatrix<f64, A, A>) -> Option<SMatrix<f64, B, B>> {
    (A == B).then(|| SMatrix::from_fn(|r, c| m[(r, c)]))
}

fn three<const D: usize>(points: &[SVector<f64, D>], chosen: &[usize]) -> [Vector3<f64>; 3] {
    std::array::from_fn(|k| Vector3::from_fn(|r, _| if r < D { points[chosen[k]][r] } else { 0.0 }))
}

/// The right-handed frame of a triangle: along the side from the second corner to the first, and its plane.
fn frame(p: &[Vector3<f64>; 3]) -> Option<Matrix3<f64>> {
    let centre = (p[0] + p[1] + p[2]) / 3.0;
    let (a, b) = (p[0] - centre, p[1] - centre);
    let normal = a.cross(&b).try_normalize(1e-12)?;
    let first = (a - b).try_normalize(1e-12)?;
    Some(Matrix3::from_columns(&[first, normal.cross(&first), normal]))
}

/// The rotation nearest to Σ y xᵀ (Kabsch, Acta Cryst. A32, 1976; sign after Umeyama, PAMI 13, 1991).
fn kabsch(yx: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let svd = yx.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut sign = Vector3::repeat(1.0);
    if u.determinant() * v_t.determinant() < 0.0 {
        sign[svd.singular_values.imin()] = -1.0;
    }
    Some(u * Matrix3::from_diagonal(&sign) * v_t)
}
