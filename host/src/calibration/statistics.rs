//! How far a fit can be trusted: standard errors and leave-one-out errors.

use super::robust::{Model, Solution};
use crate::rig::Certainty;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// Standard errors of a map, shaped as it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StandardErrors<const D: usize> {
    /// Of the linear part.
    pub linear: SMatrix<f64, D, D>,
    /// Of the map's value at the inliers' mean, in each coordinate.
    pub centre: f64,
}

/// Standard deviation of the noise in one coordinate, from the inliers; `None` when they fit exactly by their number.
pub fn noise<const D: usize>(model: Model, solution: &Solution<D>) -> Option<f64> {
    let chosen = solution.chosen();
    let freedom = (D * chosen.len()).checked_sub(model.parameters::<D>()).filter(|f| *f > 0)?;
    let squares: f64 = chosen.iter().map(|&i| solution.residuals[i].norm_squared()).sum();
    Some((squares / freedom as f64).sqrt())
}

/// How well a solution is known, as the rig's file keeps it; `None` without degrees of freedom.
pub fn certainty<const D: usize>(solution: &Solution<D>) -> Option<Certainty> {
    let (fit, chosen) = (&solution.fit, solution.chosen());
    let noise_um = noise(solution.model, solution)?;
    Some(Certainty {
        noise_um,
        freedom: D * chosen.len() - solution.model.parameters::<D>(),
        samples: chosen.len(),
        standard_errors: (0..D).map(|c| noise_um * fit.gain[(c, c)].sqrt()).collect(),
        at: fit.centre.iter().copied().collect(),
        spread: fit.gain.row_iter().map(|row| row.iter().copied().collect()).collect(),
    })
}

/// Standard errors from the inliers' residuals; `None` without degrees of freedom.
pub fn standard_errors<const D: usize>(
    model: Model,
    src: &[SVector<f64, D>],
    solution: &Solution<D>,
) -> Option<StandardErrors<D>> {
    let sigma = noise(model, solution)?;
    let fit = &solution.fit;
    let linear = match model {
        // Each row of an affine map is a regression of its own: Var = σ²·(XᵀX)⁻¹.
        Model::Affine => SMatrix::from_fn(|_, c| sigma * fit.gain[(c, c)].sqrt()),
        Model::ScaleOffset => {
            let deviation = sigma * (fit.gain[(0, 0)] * D as f64).sqrt() / (D as f64).sqrt();
            SMatrix::from_fn(|r, c| if r == c { deviation } else { 0.0 })
        }
        Model::Rigid | Model::Similarity => turned(model, sigma, src, solution),
    };
    Some(StandardErrors { linear, centre: sigma * fit.base.sqrt() })
}

/// A rotation M disturbed by small angles ω and a relative scale s is M + [ω]×M + sM; Var(ω) = σ²·I⁻¹ with the inertia
/// I of the turned points, Var(s) = σ²/Σ|Mx|².
fn turned<const D: usize>(
    model: Model,
    sigma: f64,
    src: &[SVector<f64, D>],
    solution: &Solution<D>,
) -> SMatrix<f64, D, D> {
    let m = Matrix3::from_fn(|r, c| solution.fit.map.linear[(r.min(D - 1), c.min(D - 1))]);
    let turned = solution.chosen().into_iter().map(|i| {
        let d = src[i] - solution.fit.centre;
        m * Vector3::from_fn(|r, _| d[r.min(D - 1)])
    });
    let (mut inertia, mut total) = (Matrix3::zeros(), 0.0);
    for x in turned {
        inertia += Matrix3::identity() * x.norm_squared() - x * x.transpose();
        total += x.norm_squared();
    }
    let angles = inertia.try_inverse().unwrap_or_else(|| Matrix3::repeat(f64::INFINITY));
    SMatrix::from_fn(|r, c| {
        let column: Vector3<f64> = m.column(c).into();
        let lever = column.cross(&Vector3::ith(r, 1.0));
        let scale = if model == Model::Similarity { m[(r, c)].powi(2) / total } else { 0.0 };
        sigma * (lever.dot(&(angles * lever)) + scale).sqrt()
    })
}

/// For every inlier, its distance from the map fitted without it; `None` where the others do not determine the map.
pub fn leave_one_out<const D: usize>(
    model: Model,
    src: &[SVector<f64, D>],
    dst: &[SVector<f64, D>],
    chosen: &[usize],
) -> Vec<Option<f64>> {
    // As in the solver: around the mean, so that no digits are lost far from the origin.
    let mean = src.iter().sum::<SVector<f64, D>>() / src.len() as f64;
    let src: Vec<_> = src.iter().map(|p| p - mean).collect();
    chosen
        .iter()
        .map(|&out| {
            let rest: Vec<usize> = chosen.iter().copied().filter(|&i| i != out).collect();
            if rest.len() < model.sample_size::<D>() {
                return None;
            }
            let fit = model.fit(&src, dst, &rest)?;
            // A point that alone spans a direction is predicted by nothing.
            (fit.leverage(&src[out]) < 1e4).then(|| (dst[out] - fit.map.apply(&src[out])).norm())
        })
        .collect()
}
