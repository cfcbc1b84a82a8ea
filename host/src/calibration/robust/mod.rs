//! Maps from points of which some are wrong.
//!
//! RANSAC (Fischler & Bolles 1981) with what calibrations of few points need: every minimal subset where there are few
//! enough, a check of each subset's spread, a truncated squared residual as the score (MSAC, Torr & Zisserman 2000),
//! and local optimisation of the best hypotheses (Chum, Matas & Kittler 2003). What ties is told, not guessed: a
//! manipulator moved along one axis at a time with one true and two wrong points on an axis has three maps that explain
//! as many points.
//!
//! The same points, settings and seed give the same answer, bit for bit.
//!
//! ```
//! use nalgebra::Vector2;
//! use parfocal::calibration::robust::{Model, Settings, solve};
//! let src: Vec<_> = [[0., 0.], [9., 1.], [2., 8.], [7., 6.], [4., 3.], [1., 5.]].map(Vector2::from).into();
//! let mut dst: Vec<_> = src.iter().map(|p| Vector2::new(2.0 * p.x + 100.0, -2.0 * p.y)).collect();
//! dst[3].x += 50.0; // a wrong click
//! let solution = solve(&src, &dst, &Settings { tolerance: Some(0.5), ..Settings::new(Model::Affine) })?;
//! assert_eq!(solution.inliers, [true, true, true, false, true, true]);
//! # Ok::<(), parfocal::calibration::robust::SolveError>(())
//! ```

mod draw;
mod model;
mod plain;
mod scale;
mod search;

#[cfg(test)]
mod tests;

pub use draw::{EXHAUSTIVE, binomial, draws_needed};
pub use model::{Fit, Map, Model};

use nalgebra::SVector;
use search::{Candidate, Search};
use thiserror::Error;

/// How to solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// The family of maps.
    pub model: Model,
    /// Largest distance of an inlier, in the target's unit: about four standard deviations of the noise in one
    /// coordinate. `None` estimates it from the points.
    pub tolerance: Option<f64>,
    /// Of the random draws.
    pub seed: u64,
    /// Ours, or the plain loop.
    pub estimator: Estimator,
    /// What axis scales to expect, for affine maps between equal units.
    pub prior: Option<ScalePrior>,
}

impl Settings {
    /// The robust estimator, tolerance from the data, seed 0, no prior.
    pub fn new(model: Model) -> Self {
        Self { model, tolerance: None, seed: 0, estimator: Estimator::Robust, prior: None }
    }
}

/// Which loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Estimator {
    /// This module's.
    #[default]
    Robust,
    /// Fixed N random draws, inliers counted, re-estimated when their share passes u = 0.9: for comparison.
    Plain,
}

impl std::str::FromStr for Estimator {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        match s {
            "robust" => Ok(Self::Robust),
            "plain" => Ok(Self::Plain),
            _ => Err(format!("'{s}' is not an estimator: robust or plain")),
        }
    }
}

/// Lengths of a map's columns to expect. It decides between maps that explain the points as well.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScalePrior {
    /// Expected length of a column.
    pub scale: f64,
    /// Its standard deviation.
    pub deviation: f64,
}

impl Default for ScalePrior {
    /// 1 ± 0.05: motors whose steps are known to a few per cent.
    fn default() -> Self {
        Self { scale: 1.0, deviation: 0.05 }
    }
}

/// What was found.
#[derive(Clone, Debug)]
pub struct Solution<const D: usize> {
    /// The family of maps.
    pub model: Model,
    /// Least squares over the inliers.
    pub fit: Fit<D>,
    /// Which points it rests on.
    pub inliers: Vec<bool>,
    /// Target minus prediction, for every point.
    pub residuals: Vec<SVector<f64, D>>,
    /// The tolerance used.
    pub tolerance: f64,
    /// Samples tried.
    pub draws: u64,
    /// Whether all subsets were tried.
    pub exhaustive: bool,
    /// Why this map may be the wrong one.
    pub ambiguity: Option<Ambiguity<D>>,
}

impl<const D: usize> Solution<D> {
    /// Indices of the inliers.
    pub fn chosen(&self) -> Vec<usize> {
        (0..self.inliers.len()).filter(|&i| self.inliers[i]).collect()
    }

    /// √mean‖r‖² over the inliers.
    pub fn rms(&self) -> f64 {
        let chosen = self.chosen();
        (chosen.iter().map(|&i| self.residuals[i].norm_squared()).sum::<f64>() / chosen.len() as f64).sqrt()
    }

    /// Largest ‖r‖ among the inliers.
    pub fn max(&self) -> f64 {
        self.chosen().iter().map(|&i| self.residuals[i].norm()).fold(0.0, f64::max)
    }
}

/// Why a map may be the wrong one.
#[derive(Clone, Debug)]
pub enum Ambiguity<const D: usize> {
    /// Another map explains the points as well.
    Rival {
        /// That map.
        map: Map<D>,
        /// The points it rests on.
        inliers: Vec<bool>,
    },
    /// The length of an axis rests on one point and is not what the prior expects.
    Unlikely {
        /// The source axis, from 0.
        axis: usize,
        /// Length of its column.
        scale: f64,
    },
}

/// Why there is no map.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum SolveError {
    /// Too few points.
    #[error("{have} points are too few for the {model} model: take at least {need}")]
    TooFew {
        /// The model's name.
        model: &'static str,
        /// Points there are.
        have: usize,
        /// Points it takes.
        need: usize,
    },
    /// A coordinate is not a number.
    #[error("point {0} has a coordinate that is not a finite number")]
    NotFinite(usize),
    /// The tolerance is not above 0.
    #[error("the tolerance must be above 0")]
    Tolerance,
    /// The points do not span what the model needs.
    #[error("the points do not determine the {model} model: they lie on a line or in a plane, or at one place")]
    Degenerate {
        /// The model's name.
        model: &'static str,
    },
    /// The plain loop ended without a share of inliers that passes.
    #[error(
        "the plain loop found no map that {share:.0} % of the points fit in {draws} draws: try another seed, or the robust estimator"
    )]
    PlainFailed {
        /// Draws made.
        draws: u64,
        /// Share that passes, in per cent.
        share: f64,
    },
}

/// Finds the map from `src` to `dst` that most points agree on.
///
/// # Errors
/// [`SolveError`]; points are counted from 1 in it.
pub fn solve<const D: usize>(
    src: &[SVector<f64, D>],
    dst: &[SVector<f64, D>],
    settings: &Settings,
) -> Result<Solution<D>, SolveError> {
    let (model, n) = (settings.model, src.len().min(dst.len()));
    let need = model.sample_size::<D>();
    if n < need {
        return Err(SolveError::TooFew { model: model.name(), have: n, need });
    }
    if let Some(i) = (0..n).find(|&i| !(src[i].iter().chain(dst[i].iter()).all(|v| v.is_finite()))) {
        return Err(SolveError::NotFinite(i + 1));
    }
    if settings.tolerance.is_some_and(|t| !(t > 0.0 && t.is_finite())) {
        return Err(SolveError::Tolerance);
    }
    // Far from the origin the products lose digits: work around the means.
    let (from, to) = (mean(&src[..n]), mean(&dst[..n]));
    let src: Vec<_> = src[..n].iter().map(|p| p - from).collect();
    let dst: Vec<_> = dst[..n].iter().map(|p| p - to).collect();
    let mut search = Search::new(&src, &dst, settings);
    let mut solution = match (settings.estimator, settings.tolerance) {
        (Estimator::Plain, tolerance) => {
            let tolerance = match tolerance {
                Some(tolerance) => tolerance,
                None => scale::tolerance(&mut search)?,
            };
            plain::solve(&mut search, tolerance)?
        }
        (Estimator::Robust, Some(tolerance)) => conclude(&mut search, tolerance)?,
        (Estimator::Robust, None) => scale::settle(&mut search)?,
    };
    let shift_back = |map: &mut Map<D>| map.shift += to - map.linear * from;
    shift_back(&mut solution.fit.map);
    solution.fit.centre += from;
    if let Some(Ambiguity::Rival { map, .. }) = &mut solution.ambiguity {
        shift_back(map);
    }
    Ok(solution)
}

fn mean<const D: usize>(points: &[SVector<f64, D>]) -> SVector<f64, D> {
    points.iter().sum::<SVector<f64, D>>() / points.len() as f64
}

/// Searches with a known tolerance and weighs the best against its rivals.
fn conclude<const D: usize>(search: &mut Search<'_, D>, tolerance: f64) -> Result<Solution<D>, SolveError> {
    let (mut candidates, draws, exhaustive) = search.run(tolerance);
    if let Some(best) = candidates.first_mut() {
        search.take_back(best, tolerance);
    }
    let Some(best) = candidates.first() else {
        return Err(SolveError::Degenerate { model: search.model.name() });
    };
    let ambiguity = search.rival(&candidates, tolerance).or_else(|| search.unlikely(best, tolerance));
    Ok(solution(search, best, tolerance, draws, exhaustive, ambiguity))
}

fn solution<const D: usize>(
    search: &Search<'_, D>,
    best: &Candidate<D>,
    tolerance: f64,
    draws: u64,
    exhaustive: bool,
    ambiguity: Option<Ambiguity<D>>,
) -> Solution<D> {
    Solution {
        model: search.model,
        fit: best.fit,
        inliers: flags(&best.chosen, search.src.len()),
        residuals: search.src.iter().zip(search.dst).map(|(x, y)| y - best.fit.map.apply(x)).collect(),
        tolerance,
        draws,
        exhaustive,
        ambiguity,
    }
}

fn flags(chosen: &[usize], n: usize) -> Vec<bool> {
    let mut flags = vec![false; n];
    chosen.iter().for_each(|&i| flags[i] = true);
    flags
}
