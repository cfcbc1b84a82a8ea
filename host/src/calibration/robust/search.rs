//! Hypotheses from minimal samples, the best of them made as good as they get, and what rivals the winner.

use super::draw::{EXHAUSTIVE, binomial, draw, draws_needed, next_subset};
use super::model::{Fit, Model};
use super::{Ambiguity, ScalePrior, Settings, flags};
use nalgebra::{SMatrix, SVector};
use rand::SeedableRng;
use rand_pcg::Pcg64;

/// Distinct hypotheses that are refined.
const KEPT: usize = 16;
/// A sample whose leverage over all points averages more than this spans too little to tell anything of them.
const WIDEST: f64 = 400.0;
/// Most extra tolerance that leverage earns a point outside the fit.
const MOST_LEVERAGE: f64 = 4.0;
/// Probability of having drawn a clean sample.
const CONFIDENCE: f64 = 1.0 - 1e-5;
/// Draws after which random sampling ends in any case.
const MOST_DRAWS: u64 = 5_000;
/// A point just outside is taken back up to this many tolerances squared when the fit with it leaves nothing outside: where wrong points
/// may lie anywhere, one so near is far likelier to be noise.
const NEAR: f64 = 1.69;
/// The tolerance, in standard deviations of the noise in one coordinate.
pub const TOLERANCE_SIGMAS: f64 = 4.0;
/// Largest share of a point's cost that the prior may charge for one axis: it breaks ties, it does not overrule points.
const PRIOR_CAP: f64 = 1.0;
/// Most that one axis' length counts when sets of inliers are weighed.
const SURPRISE_CAP: f64 = 25.0;
/// Maps whose costs differ by less than this share of an outlier explain the points as well as each other.
const TIE: f64 = 0.2;
/// An axis resting on one point is doubted beyond this many standard deviations from the prior.
const UNLIKELY: f64 = 3.5;

/// A refined hypothesis.
#[derive(Clone, Debug)]
pub struct Candidate<const D: usize> {
    pub fit: Fit<D>,
    pub chosen: Vec<usize>,
    /// Truncated squared residuals in units of an outlier's, and the prior's charge.
    pub cost: f64,
}

/// The points (around their means) and what is reused between hypotheses.
pub struct Search<'a, const D: usize> {
    pub src: &'a [SVector<f64, D>],
    pub dst: &'a [SVector<f64, D>],
    pub model: Model,
    pub prior: Option<ScalePrior>,
    pub rng: Pcg64,
    /// Σ x xᵀ / n over all points, around their mean 0.
    spread: SMatrix<f64, D, D>,
    /// One random word a point: a set's words, xored, name it.
    words: Vec<u64>,
}

/// A hypothesis from a minimal sample.
#[derive(Clone, Copy)]
struct Hypothesis<const D: usize> {
    cost: f64,
    set: u64,
    sample: [usize; 4],
    fit: Fit<D>,
}

impl<'a, const D: usize> Search<'a, D> {
    pub fn new(src: &'a [SVector<f64, D>], dst: &'a [SVector<f64, D>], settings: &Settings) -> Self {
        let spread = src.iter().fold(SMatrix::zeros(), |sum, x| sum + x * x.transpose()) / src.len() as f64;
        let words = (1..=src.len() as u64).map(mix).collect();
        let prior = settings.prior.filter(|_| settings.model == Model::Affine);
        Self { src, dst, model: settings.model, prior, rng: Pcg64::seed_from_u64(settings.seed), spread, words }
    }

    /// Fits a minimal sample; `None` when it spans too little.
    pub fn sample_fit(&self, sample: &[usize]) -> Option<Fit<D>> {
        let fit = self.model.fit(self.src, self.dst, sample)?;
        // Mean over all points of d'Gd, d = x − centre: tr(G·spread) + centre'G·centre.
        let mean = (fit.gain * self.spread).trace() + fit.centre.dot(&(fit.gain * fit.centre));
        (mean < WIDEST).then_some(fit)
    }

    /// Calls `visit` with minimal samples: all of them, or random ones until `visit` says how many are enough.
    /// Returns how many were tried, and whether these were all.
    pub fn samples(&mut self, mut visit: impl FnMut(&Self, &[usize]) -> Option<u64>) -> (u64, bool) {
        let (n, m) = (self.src.len(), self.model.sample_size::<D>());
        let mut buffer = [0, 1, 2, 3];
        let sample = &mut buffer[..m];
        let mut tried = 1;
        if binomial(n, m) <= EXHAUSTIVE {
            visit(self, sample);
            while next_subset(sample, n) {
                visit(self, sample);
                tried += 1;
            }
            return (tried, true);
        }
        let mut rng = self.rng.clone();
        let mut enough = MOST_DRAWS;
        // Samples that span too little tell nothing and do not count, but do not go on for ever either.
        let (mut counted, mut drawn) = (0, 0);
        while counted < enough && drawn < 20 * MOST_DRAWS {
            draw(&mut rng, sample, n);
            drawn += 1;
            if let Some(needed) = visit(self, sample) {
                counted += 1;
                enough = enough.min(needed);
            }
        }
        (drawn, false)
    }

    /// The best distinct maps at this tolerance, best first; samples tried; whether these were all.
    pub fn run(&mut self, tolerance: f64) -> (Vec<Candidate<D>>, u64, bool) {
        let (n, m) = (self.src.len(), self.model.sample_size::<D>());
        let mut best: Vec<Hypothesis<D>> = Vec::with_capacity(KEPT);
        let mut most = m;
        let (tried, all) = self.samples(|search, sample| {
            let fit = search.sample_fit(sample)?;
            let worst = if best.len() < KEPT { f64::INFINITY } else { best[KEPT - 1].cost };
            if let Some((cost, set, count)) = search.score(&fit, tolerance, worst) {
                let mut kept = [0; 4];
                kept[..m].copy_from_slice(sample);
                keep(&mut best, Hypothesis { cost, set, sample: kept, fit });
                most = most.max(count);
            }
            Some(draws_needed(CONFIDENCE, most as f64 / n as f64, m))
        });
        let mut candidates: Vec<Candidate<D>> = Vec::with_capacity(best.len());
        let mut sets = Vec::with_capacity(best.len());
        for hypothesis in &best {
            let Some(candidate) = self.refine(&hypothesis.fit, &hypothesis.sample[..m], tolerance) else { continue };
            let set = candidate.chosen.iter().fold(0, |set, &i| set ^ self.words[i]);
            if !sets.contains(&set) {
                sets.push(set);
                candidates.push(candidate);
            }
        }
        candidates.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        (candidates, tried, all)
    }

    /// Cost, set and size of a minimal sample's hypothesis; `None` once the cost exceeds `worst`.
    fn score(&self, fit: &Fit<D>, tolerance: f64, worst: f64) -> Option<(f64, u64, usize)> {
        let limit = tolerance * tolerance;
        let (mut cost, mut set, mut count) = (0.0, 0, 0);
        for ((x, y), word) in self.src.iter().zip(self.dst).zip(&self.words) {
            let r2 = (y - fit.map.apply(x)).norm_squared();
            // Most points of a wrong hypothesis are far off: their leverage need not be known.
            let scaled = if r2 > limit * (1.0 + MOST_LEVERAGE) {
                limit
            } else {
                r2 / (1.0 + fit.leverage(x).min(MOST_LEVERAGE))
            };
            if scaled < limit {
                cost += scaled / limit;
                set ^= word;
                count += 1;
            } else {
                cost += 1.0;
                if cost > worst {
                    return None;
                }
            }
        }
        Some((cost, set, count))
    }

    /// Refits and re-selects until the inliers stand still.
    pub fn refine(&self, start: &Fit<D>, sample: &[usize], tolerance: f64) -> Option<Candidate<D>> {
        let limit = tolerance * tolerance;
        let mut fit = *start;
        let mut chosen = sample.to_vec();
        let mut next = Vec::with_capacity(self.src.len());
        for _ in 0..20 {
            next.clear();
            for (i, (x, y)) in self.src.iter().zip(self.dst).enumerate() {
                let r2 = (y - fit.map.apply(x)).norm_squared();
                let near = r2 <= limit * (1.0 + MOST_LEVERAGE);
                if r2 <= limit || (near && r2 <= limit * (1.0 + fit.leverage(x).min(MOST_LEVERAGE))) {
                    next.push(i);
                }
            }
            if next == chosen {
                break;
            }
            if next.len() < sample.len() {
                return None;
            }
            fit = self.model.fit(self.src, self.dst, &next)?;
            std::mem::swap(&mut chosen, &mut next);
        }
        let cost = self.cost(&fit, &chosen, tolerance);
        Some(Candidate { fit, chosen, cost })
    }

    /// Takes back points that lie just outside, one by one, the nearest first.
    pub fn take_back(&self, candidate: &mut Candidate<D>, tolerance: f64) {
        let limit = tolerance * tolerance;
        while candidate.chosen.len() < self.src.len() {
            let scaled = |i: usize| {
                let r2 = (self.dst[i] - candidate.fit.map.apply(&self.src[i])).norm_squared();
                r2 / (1.0 + candidate.fit.leverage(&self.src[i]).min(MOST_LEVERAGE))
            };
            let outside = (0..self.src.len()).filter(|i| candidate.chosen.binary_search(i).is_err());
            let nearest = outside.map(|i| (scaled(i), i)).min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, i)) = nearest.filter(|(r2, _)| *r2 <= NEAR * limit) else { return };
            let mut chosen = candidate.chosen.clone();
            chosen.insert(chosen.partition_point(|k| *k < i), i);
            let Some(fit) = self.model.fit(self.src, self.dst, &chosen) else { return };
            let fits = |k: &usize| (self.dst[*k] - fit.map.apply(&self.src[*k])).norm_squared() <= limit;
            if !chosen.iter().all(fits) {
                return;
            }
            let cost = self.cost(&fit, &chosen, tolerance);
            *candidate = Candidate { fit, chosen, cost };
        }
    }

    /// Truncated squared residuals in outliers, and the prior's charge.
    fn cost(&self, fit: &Fit<D>, chosen: &[usize], tolerance: f64) -> f64 {
        let limit = tolerance * tolerance;
        let inside: f64 =
            chosen.iter().map(|&i| ((self.dst[i] - fit.map.apply(&self.src[i])).norm_squared() / limit).min(1.0)).sum();
        let prior: f64 = match self.prior {
            None => 0.0,
            Some(prior) => (0..D)
                .map(|axis| (deviation(fit, axis, prior, tolerance) / TOLERANCE_SIGMAS).powi(2).min(PRIOR_CAP))
                .sum(),
        };
        inside + (self.src.len() - chosen.len()) as f64 + prior
    }

    /// Squared standard deviations that the axes' lengths are from what the prior expects, when the noise has this one; each at most
    /// [`SURPRISE_CAP`], so that a wrong prior costs little.
    pub fn surprise(&self, fit: &Fit<D>, sigma: f64) -> f64 {
        let Some(prior) = self.prior else { return 0.0 };
        (0..D).map(|axis| deviation(fit, axis, prior, sigma * TOLERANCE_SIGMAS).powi(2).min(SURPRISE_CAP)).sum()
    }

    /// Another map that explains the points as well as the best.
    pub fn rival(&self, candidates: &[Candidate<D>], tolerance: f64) -> Option<Ambiguity<D>> {
        let (best, others) = candidates.split_first()?;
        let differs = |other: &Candidate<D>| {
            let squares: f64 =
                self.src.iter().map(|x| (best.fit.map.apply(x) - other.fit.map.apply(x)).norm_squared()).sum();
            squares / self.src.len() as f64 > tolerance * tolerance
        };
        // One that leaves out some of the best's points and explains no other is no rival.
        let explains = |other: &Candidate<D>| other.chosen.iter().any(|i| best.chosen.binary_search(i).is_err());
        let rival = others
            .iter()
            .take_while(|other| other.cost - best.cost < TIE)
            .find(|other| explains(other) && differs(other))?;
        Some(Ambiguity::Rival { map: rival.fit.map, inliers: flags(&rival.chosen, self.src.len()) })
    }

    /// An axis whose length rests on one inlier, while points were rejected, and is not what the prior expects.
    pub fn unlikely(&self, best: &Candidate<D>, tolerance: f64) -> Option<Ambiguity<D>> {
        let prior = self.prior?;
        if best.chosen.len() == self.src.len() {
            return None;
        }
        let (axis, _) = (0..D)
            .map(|axis| (axis, deviation(&best.fit, axis, prior, tolerance)))
            .filter(|(_, deviation)| *deviation > UNLIKELY)
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        let lone = best.chosen.iter().any(|&i| best.fit.leverage(&self.src[i]) > 0.95);
        lone.then(|| Ambiguity::Unlikely { axis, scale: best.fit.map.linear.column(axis).norm() })
    }
}

/// How many standard deviations an axis's length is from the prior's; the length's own noise counts.
fn deviation<const D: usize>(fit: &Fit<D>, axis: usize, prior: ScalePrior, tolerance: f64) -> f64 {
    let noise = (tolerance / TOLERANCE_SIGMAS).powi(2) * fit.gain[(axis, axis)];
    let length = fit.map.linear.column(axis).norm();
    (length - prior.scale).abs() / (prior.deviation.powi(2) + noise).sqrt()
}

/// Inserts in order of cost; of two with the same set the cheaper stays.
fn keep<const D: usize>(best: &mut Vec<Hypothesis<D>>, new: Hypothesis<D>) {
    if let Some(same) = best.iter().position(|h| h.set == new.set) {
        if best[same].cost <= new.cost {
            return;
        }
        best.remove(same);
    }
    let place = best.partition_point(|h| h.cost <= new.cost);
    if place < KEPT {
        best.truncate(KEPT - 1);
        best.insert(place, new);
    }
}

/// The finaliser of splitmix64 (Steele, Lea & Flood 2014).
fn mix(i: u64) -> u64 {
    let mut z = i.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}
