//! Nonlinear least squares after Levenberg (1944) and Marquardt (1963), slopes by differences. The crate `levenberg-marquardt` does
//! this too, for the nalgebra release before the one used here.

use nalgebra::{DMatrix, DVector};

/// Where the sum of squares is least.
pub(super) struct Minimum {
    pub parameters: DVector<f64>,
    /// Sum of squared residuals.
    pub cost: f64,
    /// Residuals' slopes, transposed, times themselves.
    pub normal: DMatrix<f64>,
}

/// Steps taken at most, and the share of the cost below which a gain ends the search.
const ROUNDS: usize = 60;
const GAIN: f64 = 1e-10;

/// Minimises the sum of squares of `residuals`, which are `None` where they cannot be computed. `steps`: a small change of each parameter.
pub(super) fn minimise(
    start: DVector<f64>,
    steps: &DVector<f64>,
    residuals: impl Fn(&DVector<f64>) -> Option<DVector<f64>>,
) -> Option<Minimum> {
    let mut x = start;
    let mut now = residuals(&x)?;
    let mut damping = 1e-4;
    loop {
        let mut slopes = DMatrix::zeros(now.len(), x.len());
        for k in 0..x.len() {
            let mut shifted = x.clone();
            shifted[k] += steps[k];
            slopes.set_column(k, &((residuals(&shifted)? - &now) / steps[k]));
        }
        let normal = slopes.tr_mul(&slopes);
        let gradient = slopes.tr_mul(&now);
        let cost = now.norm_squared();
        let mut better = None;
        for _ in 0..ROUNDS {
            let damped = &normal + DMatrix::from_diagonal(&normal.diagonal().map(|d| (d * damping).max(1e-12)));
            let next = damped.cholesky().map(|c| &x - c.solve(&gradient));
            let found = next.and_then(|next| residuals(&next).map(|r| (next, r)));
            if let Some((next, r)) = found
                && r.norm_squared() < cost
            {
                better = Some((next, r));
                damping = (damping / 10.0f64).max(1e-12);
                break;
            }
            if damping > 1e12 {
                break;
            }
            damping *= 10.0;
        }
        let Some((next, r)) = better else { return Some(Minimum { parameters: x, cost, normal }) };
        let gain = cost - r.norm_squared();
        (x, now) = (next, r);
        if gain < GAIN * cost {
            return Some(Minimum { parameters: x, cost: now.norm_squared(), normal });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rosenbrocks_valley_is_followed_to_its_end() {
        let valley = |x: &DVector<f64>| Some(DVector::from_vec(vec![10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]]));
        let steps = DVector::from_element(2, 1e-7);
        let found = minimise(DVector::from_vec(vec![-1.2, 1.0]), &steps, valley).unwrap();
        assert!((found.parameters - DVector::from_element(2, 1.0)).norm() < 1e-5 && found.cost < 1e-10);
    }
}
