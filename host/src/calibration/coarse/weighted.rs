//! Robust linear least squares over edges: a few unknowns, hundreds of rows, Tukey's weights against what is hidden or dirty.
//!
//! Most of a marker's measuring is spent here and in the edges: the sums are over plain arrays.

use nalgebra::{SMatrix, SVector};

/// An equation: slopes times the step make the offset.
pub(super) struct Row<const N: usize> {
    pub slopes: [f64; N],
    pub offset: f64,
    pub weight: f64,
    /// Whose rows' weights are summed up together, 0 or 1: the picture it was measured in.
    pub picture: usize,
}

impl<const N: usize> Row<N> {
    fn miss(&self, by: &SVector<f64, N>) -> f64 {
        self.offset - self.slopes.iter().zip(by.as_slice()).map(|(s, b)| s * b).sum::<f64>()
    }
}

/// The step, and what it rests on.
pub(super) struct Solved<const N: usize> {
    pub by: SVector<f64, N>,
    pub normal: SMatrix<f64, N, N>,
    /// Sum of Tukey's weights in each picture.
    pub kept: [f64; 2],
    /// Sums over rows of Tukey's weights alone, and times squared misses with and without the rows' own weights.
    pub weights: f64,
    pub weighted_squares: f64,
    pub squares: f64,
}

/// Solves with weights that follow the residuals, so many times: first all alike, then Huber's, which find their way past a third of wrong
/// rows, at last Tukey's, which leave them out. `prior` is added to the normal equations' diagonal; residuals below
/// `least` of their standard deviations count in full.
pub(super) fn solve<const N: usize>(rows: &[Row<N>], prior: [f64; N], rounds: usize, least: f64) -> Option<Solved<N>> {
    let mut solved = Solved {
        by: SVector::zeros(),
        normal: SMatrix::zeros(),
        kept: [0.0; 2],
        weights: 0.0,
        weighted_squares: 0.0,
        squares: 0.0,
    };
    let mut scale = f64::INFINITY;
    for round in 0..rounds {
        let mut products = [[0.0; N]; N];
        let mut gradient = [0.0; N];
        (solved.kept, solved.weights, solved.weighted_squares, solved.squares) = ([0.0; 2], 0.0, 0.0, 0.0);
        for row in rows {
            let miss = row.miss(&solved.by);
            let deviations = miss.abs() * row.weight.sqrt();
            let robust =
                if round > 0 && round <= rounds / 3 { huber(deviations / least) } else { tukey(deviations / scale) };
            let weight = row.weight * robust;
            for (i, a) in row.slopes.iter().enumerate() {
                for (sum, b) in products[i].iter_mut().zip(&row.slopes) {
                    *sum += weight * a * b;
                }
                gradient[i] += weight * a * row.offset;
            }
            solved.kept[row.picture] += robust;
            solved.weights += robust;
            solved.weighted_squares += weight * miss * miss;
            solved.squares += robust * miss * miss;
        }
        solved.normal = SMatrix::from_fn(|i, j| products[i][j] + if i == j { prior[i] } else { 0.0 });
        solved.by = solved.normal.cholesky()?.solve(&SVector::from(gradient));
        let mut far: Vec<f64> = rows.iter().map(|row| row.miss(&solved.by).abs() * row.weight.sqrt()).collect();
        far.sort_by(f64::total_cmp);
        scale = (1.4826 * far.get(far.len() / 2)?).max(least);
    }
    Some(solved)
}

/// Huber's weight at one standard deviation.
fn huber(r: f64) -> f64 {
    1.0 / r.max(1.0)
}

/// Tukey's biweight at 4.685 standard deviations.
pub(super) fn tukey(r: f64) -> f64 {
    let u = (r / 4.685).powi(2);
    if u < 1.0 { (1.0 - u).powi(2) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_found_through_points_of_which_a_third_is_elsewhere() {
        let point = |k: i32| {
            let x = f64::from(k) / 10.0;
            let wrong = if k % 3 == 0 { 5.0 } else { 0.0 };
            Row { slopes: [x, 1.0], offset: 0.7 * x - 0.2 + wrong, weight: 100.0, picture: (k % 2) as usize }
        };
        let rows: Vec<_> = (0..60).map(point).collect();
        let found = solve(&rows, [1e-9; 2], 12, 1.0).unwrap();
        assert!((found.by - SVector::from([0.7, -0.2])).norm() < 1e-3, "{}", found.by);
        assert!(found.kept.iter().all(|kept| (*kept - 20.0).abs() < 0.5), "{:?}", found.kept);
    }
}
