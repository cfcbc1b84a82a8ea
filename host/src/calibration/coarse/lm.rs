//! Nonlinear least squares after Levenberg (1944) and Marquardt (1963) over any kind of unknowns: whoever asks says how a step moves them. The
//! crate `levenberg-marquardt` does this too, for the nalgebra release before the one used here, and wants the slopes as one dense matrix.

use nalgebra::{DMatrix, DVector};

/// Least squares at one place: residuals' squares, slopes' products.
pub(super) struct Equations {
    /// Sum of squared residuals.
    pub cost: f64,
    /// Residuals' slopes, transposed, times themselves.
    pub normal: DMatrix<f64>,
    /// Residuals' slopes, transposed, times the residuals.
    pub gradient: DVector<f64>,
}

/// What is fitted: unknowns that a vector of small steps moves.
pub(super) trait Problem {
    type Unknowns: Clone;

    /// The equations at some unknowns; `None` where they have no meaning.
    fn equations(&self, at: &Self::Unknowns) -> Option<Equations>;

    /// The sum of squares alone.
    fn cost(&self, at: &Self::Unknowns) -> Option<f64>;

    /// The unknowns moved.
    fn moved(&self, at: &Self::Unknowns, by: &DVector<f64>) -> Self::Unknowns;
}

/// Where the sum of squares is least.
pub(super) struct Minimum<X> {
    pub unknowns: X,
    /// The equations there.
    pub equations: Equations,
}

/// Steps at most, and the share of the cost below which a gain ends the search.
const STEPS: usize = 100;
const GAIN: f64 = 1e-9;
/// Damping beyond which nothing moves any more.
const STUCK: f64 = 1e12;

/// Minimises a problem's sum of squares. `None` when it has no meaning at the start.
pub(super) fn minimise<P: Problem>(problem: &P, start: P::Unknowns) -> Option<Minimum<P::Unknowns>> {
    let mut x = start;
    let mut now = problem.equations(&x)?;
    let mut damping = 1e-4;
    for _ in 0..STEPS {
        let better = loop {
            let damped = &now.normal + DMatrix::from_diagonal(&now.normal.diagonal().map(|d| (d * damping).max(1e-12)));
            let next = damped.cholesky().map(|c| problem.moved(&x, &-c.solve(&now.gradient)));
            let found = next.and_then(|next| problem.cost(&next).map(|cost| (next, cost)));
            match found {
                Some((next, cost)) if cost < now.cost => break Some((next, cost)),
                _ if damping > STUCK => break None,
                _ => damping *= 10.0,
            }
        };
        let Some((next, cost)) = better else { break };
        damping = (damping / 10.0).max(1e-12);
        let gain = now.cost - cost;
        (x, now) = (next.clone(), problem.equations(&next)?);
        if gain < GAIN * cost {
            break;
        }
    }
    Some(Minimum { unknowns: x, equations: now })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's function as a sum of two squares.
    struct Valley;

    impl Problem for Valley {
        type Unknowns = [f64; 2];

        fn equations(&self, [x, y]: &[f64; 2]) -> Option<Equations> {
            let residuals = DVector::from_vec(vec![10.0 * (y - x * x), 1.0 - x]);
            let slopes = DMatrix::from_row_slice(2, 2, &[-20.0 * x, 10.0, -1.0, 0.0]);
            let (normal, gradient) = (slopes.tr_mul(&slopes), slopes.tr_mul(&residuals));
            Some(Equations { cost: residuals.norm_squared(), normal, gradient })
        }

        fn cost(&self, at: &[f64; 2]) -> Option<f64> {
            self.equations(at).map(|e| e.cost)
        }

        fn moved(&self, at: &[f64; 2], by: &DVector<f64>) -> [f64; 2] {
            [at[0] + by[0], at[1] + by[1]]
        }
    }

    #[test]
    fn rosenbrocks_valley_is_followed_to_its_end() {
        let found = minimise(&Valley, [-1.2, 1.0]).unwrap();
        let [x, y] = found.unknowns;
        assert!((x - 1.0).abs() < 1e-5 && (y - 1.0).abs() < 1e-5 && found.equations.cost < 1e-10, "{x} {y}");
    }
}
