//! The tolerance, when nobody gives one.
//!
//! Of all hypotheses and all numbers of inliers take the one under which the points are likeliest: inliers' residuals normal with one standard
//! deviation, the others' with another, both unknown and integrated out as far as they go, and paid for by the number of sets that could have been
//! chosen. That needs no idea of how far off wrong points are: tens of µm among points a millimetre apart stand out as well as gross ones. From
//! then on the tolerance is four standard deviations of the inliers' residuals, and solver and tolerance take turns until both
//! stand still.

use super::model::Fit;
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

/// A first tolerance: that of the likeliest set.
pub fn tolerance<const D: usize>(search: &mut Search<'_, D>) -> Result<f64, SolveError> {
    let (n, m) = (search.src.len(), search.model.sample_size::<D>());
    let floor = extent(search.dst) * FINEST;
    let least = (floor * floor).max(f64::MIN_POSITIVE);
    if n == m {
        // An exact fit has no residuals to learn from.
        return Ok(floor.max(f64::MIN_POSITIVE));
    }
    // For every number of inliers, the sample whose nearest points fit it best, its axes' lengths being likely ones.
    let mut best: Vec<Option<(f64, Vec<usize>)>> = vec![None; n + 1];
    let mut sorted: Vec<(f64, usize)> = Vec::with_capacity(n);
    search.samples(|search, sample| {
        let fit = search.sample_fit(sample)?;
        nearest(search, &fit, &mut sorted);
        let mut inside = 0.0;
        for k in 1..=n {
            inside += sorted[k - 1].0;
            let free = (D * k).saturating_sub(search.model.parameters::<D>()) as f64;
            if k <= m || free == 0.0 {
                continue;
            }
            let near = (inside / free).max(least);
            let least = best[k].as_ref().map_or(f64::INFINITY, |(least, _)| *least);
            // The lengths' share is never below 0: most samples need not be asked for it.
            let mut unlikely = free * near.ln();
            if unlikely < least {
                unlikely += search.surprise(&fit, near.sqrt());
            }
            if unlikely < least {
                best[k] = Some((unlikely, sorted[..k].iter().map(|(_, i)| *i).collect()));
            }
        }
        Some(DRAWS)
    });
    let mut levels: Vec<Level> = Vec::new();
    for (_, mut chosen) in best.into_iter().flatten() {
        let k = chosen.len();
        // Concentrate: fit, take the k nearest, until they stand still (Rousseeuw & Van Driessen 1999).
        let mut fit = None;
        for _ in 0..CONCENTRATIONS {
            chosen.sort_unstable();
            let Some(found) = search.model.fit(search.src, search.dst, &chosen) else { break };
            nearest(search, &found, &mut sorted);
            fit = Some(found);
            let mut next: Vec<usize> = sorted[..k].iter().map(|(_, i)| *i).collect();
            next.sort_unstable();
            if next == chosen {
                break;
            }
            chosen = next;
        }
        let Some(fit) = fit else { continue };
        let r2 = |i: usize| (search.dst[i] - fit.map.apply(&search.src[i])).norm_squared();
        let free = (D * k).saturating_sub(search.model.parameters::<D>());
        if free == 0 {
            continue;
        }
        let (free, rest) = (free as f64, (D * (n - k)) as f64);
        let near = (chosen.iter().map(|&i| r2(i)).sum::<f64>() / free).max(least);
        // Not in units of noise: beside a small set every point is far off by that.
        let out: f64 = (0..n).filter(|i| chosen.binary_search(i).is_err()).map(r2).sum();
        let far = if k == n { 1.0 } else { (out / rest).max(near) };
        let choices = log_binomial(n, k) + log_binomial(k, m) + entropy(k, n);
        let unlikely = 0.5 * (free * near.ln() + rest * far.ln() + search.surprise(&fit, near.sqrt())) + choices;
        // The best of many sets fits by chance as well: by about one standard deviation of its own.
        let generous = 1.0 + if k == n { 0.0 } else { 1.0 / (2.0 * free).sqrt() };
        let tolerance = (TOLERANCE_SIGMAS * near.sqrt() * generous).max(floor);
        levels.push(Level { unlikely, tolerance, chosen });
    }
    levels.sort_by(|a, b| a.unlikely.total_cmp(&b.unlikely));
    let Some(likeliest) = levels.first() else {
        return Err(SolveError::Degenerate { model: search.model.name() });
    };
    let widens = |level: &&Level| {
        level.tolerance < LOOSER * likeliest.tolerance
            && likeliest.chosen.iter().all(|i| level.chosen.binary_search(i).is_ok())
    };
    let near = levels.iter().take_while(|level| level.unlikely - likeliest.unlikely < MARGIN).filter(widens);
    Ok(near.max_by_key(|level| level.chosen.len()).unwrap_or(likeliest).tolerance)
}

/// A number of inliers, the set that suits it best, and the noise that they would have.
struct Level {
    /// −log of the likelihood, give or take a constant.
    unlikely: f64,
    tolerance: f64,
    /// In order.
    chosen: Vec<usize>,
}

/// The tightest of many sets is tight by chance as well: one that holds the likeliest set and more points is taken when it is less
/// likely by no more than this…
const MARGIN: f64 = 6.0;
/// … and not looser by this factor.
const LOOSER: f64 = 4.0;

/// Most rounds of fitting and choosing anew.
const CONCENTRATIONS: usize = 10;

/// The points by their squared distance from a fit, in units of what noise alone makes there.
fn nearest<const D: usize>(search: &Search<'_, D>, fit: &Fit<D>, sorted: &mut Vec<(f64, usize)>) {
    sorted.clear();
    sorted.extend(
        search
            .src
            .iter()
            .zip(search.dst)
            .enumerate()
            .map(|(i, (x, y))| ((y - fit.map.apply(x)).norm_squared() / (1.0 + fit.leverage(x)), i)),
    );
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
}

/// −log of the likelihood of k right points among n when their share is k/n.
fn entropy(k: usize, n: usize) -> f64 {
    let part = |k: usize| if k == 0 { 0.0 } else { k as f64 * (n as f64 / k as f64).ln() };
    part(k) + part(n - k)
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

fn log_binomial(n: usize, k: usize) -> f64 {
    if k > n {
        return 0.0;
    }
    (0..k).map(|i| ((n - i) as f64 / (i + 1) as f64).ln()).sum()
}
