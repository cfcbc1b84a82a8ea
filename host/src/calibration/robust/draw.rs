//! Which samples to try: every subset when there are few, else random ones.

use rand::RngExt;
use rand_pcg::Pcg64;

/// Subsets up to which all are tried.
pub const EXHAUSTIVE: u64 = 5_000;

/// Draws until one is all inliers with probability `p`, when a point is one with probability `u`:
/// N = ⌈log(1−p)/log(1−u^m)⌉ (Fischler & Bolles 1981).
///
/// ```
/// use parfocal::calibration::robust::draws_needed;
/// assert_eq!((draws_needed(0.99, 0.9, 3), draws_needed(0.99, 0.9, 4)), (4, 5));
/// ```
pub fn draws_needed(p: f64, u: f64, m: usize) -> u64 {
    let clean = u.powi(m as i32);
    if clean >= 1.0 {
        return 1;
    }
    // In floats the quotient of an exact answer may lie a hair above it.
    ((1.0 - p).ln() / (-clean).ln_1p() - 1e-9).ceil().max(1.0) as u64
}

/// C(n, k), saturating.
pub fn binomial(n: usize, k: usize) -> u64 {
    (0..k.min(n - k)).try_fold(1u64, |c, i| Some(c.checked_mul((n - i) as u64)? / (i as u64 + 1))).unwrap_or(u64::MAX)
}

/// Moves to the next subset in lexical order; false after the last.
pub fn next_subset(sample: &mut [usize], n: usize) -> bool {
    let m = sample.len();
    let Some(k) = (0..m).rev().find(|&k| sample[k] < n - m + k) else { return false };
    sample[k] += 1;
    for j in k + 1..m {
        sample[j] = sample[j - 1] + 1;
    }
    true
}

/// Draws distinct indices below `n`.
pub fn draw(rng: &mut Pcg64, sample: &mut [usize], n: usize) {
    for k in 0..sample.len() {
        sample[k] = loop {
            let i = rng.random_range(0..n);
            if !sample[..k].contains(&i) {
                break i;
            }
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn all_subsets_come_once() {
        let mut sample = [0, 1, 2];
        let mut seen = std::collections::BTreeSet::from([sample]);
        while next_subset(&mut sample, 7) {
            assert!(seen.insert(sample));
        }
        assert_eq!(seen.len() as u64, binomial(7, 3));
        assert_eq!((binomial(50, 4), binomial(4, 4), binomial(10, 3)), (230_300, 1, 120));
    }

    #[test]
    fn the_chapters_numbers() {
        assert_eq!(draws_needed(0.99, 0.9, 3), 4);
        assert_eq!(draws_needed(0.99, 0.9, 4), 5);
        assert_eq!(draws_needed(0.99, 1.0, 4), 1);
    }

    #[test]
    fn draws_are_distinct_and_repeat_with_their_seed() {
        let run = || {
            let mut rng = Pcg64::seed_from_u64(3);
            (0..100)
                .map(|_| {
                    let mut s = [0; 4];
                    draw(&mut rng, &mut s, 5);
                    s
                })
                .collect::<Vec<_>>()
        };
        assert_eq!(run(), run());
        assert!(run().iter().all(|s| (0..4).all(|i| !s[..i].contains(&s[i]))));
    }
}
