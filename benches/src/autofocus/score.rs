//! The rules of the comparison.

use super::STEP;
use super::curves::Truth;
use super::runs::Walk;
use std::fmt;

/// A run has found the peak within this distance, µm.
const FOUND: f64 = 1.0;

/// A start within this distance of the peak has to see both sides of it, µm.
const NEAR: f64 = 20.0;

/// Frames that a run may take beyond two for each sample step of its way.
const FRAMES: f64 = 100.0;

/// What many runs amount to.
#[derive(Debug, Default)]
pub struct Score {
    found: usize,
    over_budget: usize,
    frames: u64,
    /// dJ = J − |zstar − z0| − J0, µm, of starts far from the peak and near it.
    far: Vec<f64>,
    near: Vec<f64>,
}

/// The table's head, above what [`Score`] prints.
pub const HEAD: &str = "success   dJ median     p95 | most: far    near | frames  over budget";

impl Score {
    /// Takes in one run.
    pub fn add(&mut self, curve: &Truth, z0: f64, j0: f64, walk: &Walk) {
        let (travel, distance) = (walk.travel(), (curve.zstar - z0).abs());
        self.found += usize::from((walk.end() - curve.zstar).abs() <= FOUND);
        self.over_budget += usize::from(f64::from(walk.frames) > 2.0 * travel / STEP + FRAMES);
        self.frames += u64::from(walk.frames);
        let starts = if distance > NEAR { &mut self.far } else { &mut self.near };
        starts.push(travel - distance - j0);
    }
}

impl fmt::Display for Score {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut all = [&self.far[..], &self.near[..]].concat();
        all.sort_by(f64::total_cmp);
        let n = all.len();
        if n == 0 {
            return write!(f, "no curves");
        }
        let at = |q: f64| all[((n - 1) as f64 * q).round() as usize];
        let most = |of: &[f64]| of.iter().copied().reduce(f64::max).map_or("-".into(), |m| format!("{m:.1}"));
        let (found, frames) = (100.0 * self.found as f64 / n as f64, self.frames / n as u64);
        write!(f, "{found:>6.2}% {:>11.1} {:>7.1}", at(0.5), at(0.95))?;
        write!(f, " | {:>9} {:>7} | {frames:>6}  {:>11}", most(&self.far), most(&self.near), self.over_budget)
    }
}
