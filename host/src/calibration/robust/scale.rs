//! The tolerance, when nobody gives one.
//!
//! A contrario (Moisan & Stival, IJCV 57, 2004): of all hypotheses and all numbers of inliers take those that chance
//! would least produce. That gives a first set without any scale; from then on the tolerance is four standard
//! deviations of the inliers' residuals, and solver and tolerance take turns until both stand still.

use super::search::{Search, TOLERANCE_SIGMAS};
use super::{Solution, SolveError, conclude};
use nalgebra::SVector;

/// The smallest tolerance, as a share of the points' extent: exact points have residuals of rounding only.
const FINEST: f64 = 1e-6;
/// Random samples looked at where they are too many for all.
const DRAWS: u64 = 1_000;

/// Solves with a tolerance found from the points.
pub fn settle<const D: usize>(search: &mut Search<'_, D>) -> Result<Solution<D>, SolveError> {
    let mut tolerance = tolerance(search)?;
    let mut solution = conclude(search, tolerance)?;
    for _ in 0..10 {
        let chosen = solution.chosen();
        let Some(next) = from_residuals(search, &chosen, &solution.residuals) else { break };
        // Growing only: a tolerance that shrinks with the set it chose eats the set.
        if next <= tolerance * 1.001 {
            break;
        }
        tolerance = next;
        solution = conclude(search, tolerance)?;
    }
    Ok(solution)
}

/// A first tolerance: that of the least accidental set.
pub fn tolerance<const D: usize>(search: &mut Search<'_, D>) -> Result<f64, SolveError> {
    let (n, m) = (search.src.len(), search.model.sample_size::<D>());
    let floor = extent(search.dst) * FINEST;
    if n == m {
        // An exact fit has no residuals to learn from.
        return Ok(floor.max(f64::MIN_POSITIVE));
    }
    let combinations: Vec<f64> = (0..=n).map(|k| log_binomial(n, k) + log_binomial(k, m)).collect();
    let volume = (extent(search.dst)).powi(D as i32).max(f64::MIN_POSITIVE);
    let mut sorted: Vec<(f64, usize)> = Vec::with_capacity(n);
    let mut best: Option<(f64, Vec<usize>)> = None;
    search.samples(|search, sample| {
        let fit = search.sample_fit(sample)?;
        sorted.clear();
        sorted.extend(search.src.iter().zip(search.dst).enumerate().map(|(i, (x, y))| {
            let r = (y - fit.map.apply(x)).norm() / (1.0 + fit.leverage(x)).sqrt();
            (if sample.contains(&i) { 0.0 } else { r }, i)
        }));
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        for k in m + 1..=n {
            let share = (ball::<D>() * sorted[k - 1].0.max(floor).powi(D as i32) / volume).min(1.0);
            let accident = combinations[k] + (k - m) as f64 * share.ln();
            if best.as_ref().is_none_or(|(least, _)| accident < *least) {
                best = Some((accident, sorted[..k].iter().map(|(_, i)| *i).collect()));
            }
        }
        Some(DRAWS)
    });
    let degenerate = SolveError::Degenerate { model: search.model.name() };
    let (_, mut chosen) = best.ok_or(degenerate)?;
    chosen.sort_unstable();
    let fit = search.model.fit(search.src, search.dst, &chosen).ok_or(degenerate)?;
    let residuals: Vec<_> = search.src.iter().zip(search.dst).map(|(x, y)| y - fit.map.apply(x)).collect();
    Ok(from_residuals(search, &chosen, &residuals).unwrap_or(floor))
}

/// Four standard deviations of the chosen points' residuals; `None` without degrees of freedom.
fn from_residuals<const D: usize>(
    search: &Search<'_, D>,
    chosen: &[usize],
    residuals: &[SVector<f64, D>],
) -> Option<f64> {
    let freedom = (D * chosen.len()).checked_sub(search.model.parameters::<D>()).filter(|f| *f > 0)?;
    let squares: f64 = chosen.iter().map(|&i| residuals[i].norm_squared()).sum();
    Some((TOLERANCE_SIGMAS * (squares / freedom as f64).sqrt()).max(extent(search.dst) * FINEST))
}

/// The largest distance from the mean, 0.
fn extent<const D: usize>(points: &[SVector<f64, D>]) -> f64 {
    2.0 * points.iter().map(|p| p.norm()).fold(0.0, f64::max)
}

/// Volume of the unit ball in `D` dimensions.
fn ball<const D: usize>() -> f64 {
    if D == 2 { std::f64::consts::PI } else { 4.0 / 3.0 * std::f64::consts::PI }
}

fn log_binomial(n: usize, k: usize) -> f64 {
    if k > n {
        return 0.0;
    }
    (0..k).map(|i| ((n - i) as f64 / (i + 1) as f64).ln()).sum()
}
