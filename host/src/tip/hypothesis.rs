//! Pipettes that may be there, and how sure each is.

use super::drawn::Seam;
use super::fit::{self, Fit, Prior};
use super::model::Cone;
use super::patch::Patch;
use super::pyramid::Level;
use super::search::Candidate;
use super::verify::{Explained, explained};

/// A fitted pipette and what speaks for it.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    pub fit: Fit,
    pub evidence: [f64; EVIDENCE],
}

/// Weights of the evidence before and after the closer look.
pub type Weights = ([f64; EVIDENCE], f64);

/// Kinds of evidence.
const EVIDENCE: usize = 11;

/// A false tip is worse than none: even odds, less this, count as such.
const CAREFUL: f64 = 1.8;

/// Logistic weights from random scenes with and without pipettes.
pub const COARSE: Weights = ([-0.866, -3.956, -4.135, 0.916, 1.214, 4.038, 1.275, 0.474, -1.330, 0.252, 0.111], 1.494);
pub const FINE: Weights =
    ([-0.685, -2.649, -4.751, 1.968, 0.626, 4.874, 1.046, 0.485, -1.743, 0.701, -0.152], -2.856 - CAREFUL);

impl Hypothesis {
    fn new(levels: &[Level], noise: f64, variance: f64, mass: f64, fit: Fit) -> Self {
        let Explained { near, middle, far, rings } = explained(levels, &fit, noise);
        // A small picture cannot hold the wide rings.
        let held = rings_held(levels);
        let rings = rings + (11.0 - held);
        let gain = mass * (fit.empty / fit.residual.max(1e-12)).max(1.0).ln();
        let evidence = [
            gain.max(1.0).ln(),
            fit.cone.ln_opening,
            (fit.error_across + 0.05).ln(),
            (fit.error_along + 0.1).ln(),
            near,
            middle,
            far,
            rings,
            // A picture without noise shows more than the model knows.
            (fit.residual / variance).ln().min(1.5),
            (fit.mix[0].abs() / variance.sqrt() + 1e-3).ln(),
            0.1 * fit.cone.blur.abs(),
        ];
        Self { fit, evidence }
    }

    /// The logarithm of the odds that this is a pipette's tip.
    pub fn log_odds(&self, (weights, bias): &Weights) -> f64 {
        bias + weights.iter().zip(&self.evidence).map(|(w, e)| w * e).sum::<f64>()
    }
}

pub fn prior(expected_opening_px: f64) -> Prior {
    let far = f64::INFINITY;
    Prior {
        mean: [0.0, 0.0, 0.0, expected_opening_px.ln(), 0.2_f64.ln(), 0.0, 0.65_f64.ln()],
        deviation: [far, far, far, 0.5, 0.4, 20.0, 0.5],
    }
}

/// Radius of an opening, as far as nothing is known of it.
const OPENING_PX: f64 = 3.0;

/// Starts that are fitted at the first look.
const FITTED: usize = 8;

/// A first look at candidates, focused above or below their tips; best first, those in one place once.
pub fn coarse(levels: &[Level], noise: f64, candidates: &[Candidate]) -> Vec<Hypothesis> {
    let prior = prior(OPENING_PX);
    let Some(level) = levels.get(2.min(levels.len() - 1)) else { return Vec::new() };
    let variance = (noise / level.step as f64).powi(2);
    let mut starts: Vec<(f64, Patch, Cone)> = candidates
        .iter()
        .filter_map(|c| {
            let patch = Patch::cut(level, c.x, c.y, 80.0, 1.0);
            let starts = [-16.0, -3.0, 10.0].map(|blur| Cone {
                x: c.x,
                y: c.y,
                angle: c.angle,
                ln_opening: OPENING_PX.ln(),
                ln_widening: 0.2_f64.ln(),
                blur,
                ln_slope: 0.65_f64.ln(),
            });
            let gains = starts.map(|start| (fit::gain(&patch, &start), start));
            let (gain, start) = gains.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
            Some((gain, patch, start))
        })
        .collect();
    starts.sort_by(|a, b| b.0.total_cmp(&a.0));
    starts.truncate(FITTED);
    let mut found: Vec<Hypothesis> = starts
        .iter()
        .filter_map(|(_, patch, start)| {
            let fit = fit::fit(patch, *start, &prior, variance, Seam::Without, 6)?;
            Some(Hypothesis::new(levels, noise, variance, patch.mass, fit))
        })
        .collect();
    found.sort_by(|a, b| b.log_odds(&COARSE).total_cmp(&a.log_odds(&COARSE)));
    distinct(found)
}

/// A closer look at hypotheses; best first.
pub fn fine(levels: &[Level], noise: f64, found: &[Hypothesis]) -> Vec<Hypothesis> {
    let prior = prior(OPENING_PX);
    let level = &levels[1.min(levels.len() - 1)];
    let variance = (noise / level.step as f64).powi(2);
    let mut better: Vec<Hypothesis> = found
        .iter()
        .filter_map(|h| {
            let patch = Patch::cut(level, h.fit.cone.x, h.fit.cone.y, 64.0, 1.0);
            let mut fit = fit::fit(&patch, h.fit.cone, &prior, variance, Seam::With, 8)?;
            let opening = fit.cone.ln_opening.exp();
            if opening > 1.5 * OPENING_PX {
                // A large pipette is looked at as a whole: the pixels are finer.
                let unit = opening / OPENING_PX;
                let (level, radius) = if opening > 3.0 * OPENING_PX { (levels.get(2)?, 160.0) } else { (level, 100.0) };
                let patch = Patch::cut(level, fit.cone.x, fit.cone.y, radius, unit);
                let variance = (noise / level.step as f64).powi(2);
                fit = fit::fit(&patch, fit.cone, &prior, variance, Seam::With, 12)?;
                return Some(Hypothesis::new(levels, noise, variance, patch.mass, fit));
            }
            Some(Hypothesis::new(levels, noise, variance, patch.mass, fit))
        })
        .collect();
    better.sort_by(|a, b| b.log_odds(&FINE).total_cmp(&a.log_odds(&FINE)));
    distinct(better)
}

/// A last look at a tip that is nearly in focus, at the picture's full detail.
pub fn polish(levels: &[Level], noise: f64, h: &Hypothesis) -> Option<Fit> {
    let cone = &h.fit.cone;
    let level = &levels[0];
    let sharp = cone.blur.abs() < SHARP_PX && h.fit.unit == 1.0;
    let patch = sharp.then(|| Patch::cut(level, cone.x, cone.y, 40.0, 1.0))?;
    fit::fit(&patch, *cone, &prior(OPENING_PX), (noise / level.step as f64).powi(2), Seam::With, 5)
}

/// A tip blurred over less than this shows more at full detail, px.
const SHARP_PX: f64 = 9.0;

/// The direction of a clearly seen pipette by its shank: near the tip a real one is bent.
pub fn shank_angle(levels: &[Level], cone: &Cone, noise: f64) -> Option<f64> {
    let level = &levels[1.min(levels.len() - 1)];
    let variance = (noise / level.step as f64).powi(2);
    let back = (12.0 * cone.ln_opening.exp()).clamp(40.0, 180.0);
    let (sin, cos) = cone.angle.sin_cos();
    let patch = Patch::cut(level, cone.x - back * cos, cone.y - back * sin, 1.3 * back, 1.0);
    let fit = fit::fit(&patch, *cone, &prior(OPENING_PX), variance, Seam::Without, 10)?;
    let turn = (fit.cone.angle - cone.angle).abs();
    (turn < 0.15).then_some(fit.cone.angle)
}

/// How many rings a picture of this size can hold on one side of a place.
fn rings_held(levels: &[Level]) -> f64 {
    let size = levels.first().map_or(0, |l| l.step * l.width.max(l.height)) as f64;
    super::verify::RINGS.iter().filter(|(radius, _)| *radius < 0.55 * size).count() as f64
}

fn distinct(sorted: Vec<Hypothesis>) -> Vec<Hypothesis> {
    let mut kept: Vec<Hypothesis> = Vec::new();
    for h in sorted {
        let same = |k: &Hypothesis| {
            (k.fit.cone.x - h.fit.cone.x).hypot(k.fit.cone.y - h.fit.cone.y) < 10.0
                && (k.fit.cone.angle - h.fit.cone.angle).cos() > 0.8
        };
        if h.fit.cone.x.is_finite() && !kept.iter().any(same) {
            kept.push(h);
        }
    }
    kept
}
