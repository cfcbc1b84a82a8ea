//! The plain loop, for comparison: a fixed number of random draws, inliers counted, re-estimated when enough agree.

use super::draw::{draw, draws_needed};
use super::search::{Candidate, Search};
use super::{Solution, SolveError, solution};

/// Probability that one draw is clean, and the share of inliers assumed, which is also the share that ends the loop.
const P: f64 = 0.99;
const U: f64 = 0.9;

/// At most N = ⌈log(1−p)/log(1−u^m)⌉ draws; the first whose inliers pass the share ends it. When none does, the draw
/// with most inliers is re-estimated, as users of such loops do.
pub fn solve<const D: usize>(search: &mut Search<'_, D>, tolerance: f64) -> Result<Solution<D>, SolveError> {
    let (n, m) = (search.src.len(), search.model.sample_size::<D>());
    let draws = draws_needed(P, U, m);
    let mut best: Vec<usize> = Vec::new();
    let mut made = 0;
    let mut buffer = [0; 4];
    let sample = &mut buffer[..m];
    while made < draws && (best.len() as f64) < U * n as f64 {
        draw(&mut search.rng, sample, n);
        made += 1;
        let Some(fit) = search.model.fit(search.src, search.dst, sample) else { continue };
        let inside = |&i: &usize| (search.dst[i] - fit.map.apply(&search.src[i])).norm() <= tolerance;
        let chosen: Vec<usize> = (0..n).filter(inside).collect();
        if chosen.len() > best.len() {
            best = chosen;
        }
    }
    let failed = SolveError::PlainFailed { draws, share: 100.0 * U };
    if best.len() < m {
        return Err(failed);
    }
    let fit = search.model.fit(search.src, search.dst, &best).ok_or(failed)?;
    Ok(solution(search, &Candidate { fit, chosen: best, cost: 0.0 }, tolerance, made, false, None))
}
