//! Pipettes that may be there, and how sure each is.

use super::drawn::Seam;
use super::fit::{self, Fit, Prior};
use super::model::{Cone, SEAM};
use super::patch::Patch;
use super::pyramid::Level;
use super::search::Candidate;
use super::verify::{Explained, explained};
use super::weights::{AFAR, COARSE, EVIDENCE, OF_FIT, OF_WIDE, Weights, odds_of};

/// A fitted pipette and what speaks for it.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    pub fit: Fit,
    pub evidence: [f64; EVIDENCE],
    /// Mean square that the fit leaves, over noise's.
    pub unexplained: f64,
}

impl Hypothesis {
    fn new(levels: &[Level], noise: f64, variance: f64, mass: f64, fit: Fit) -> Self {
        let Explained { near, middle, far, rings } = explained(levels, &fit, noise);
        // A small picture cannot hold the wide rings.
        let held = rings_held(levels);
        let rings = rings + (11.0 - held);
        let gain = mass * (fit.empty / fit.residual.max(1e-12)).max(1.0).ln();
        let [glass, lumen, seam] = fit.mix;
        let of_fit: [f64; OF_FIT] = [
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
            (glass.abs() / variance.sqrt() + 1e-3).ln(),
            0.1 * fit.cone.blur.abs(),
            fit.explained.max(-1.0),
            // Where glass and lumen are as the model has them, the lumen differs by nothing, and the seam has the glass's sign.
            (lumen / glass).abs().min(3.0),
            (seam / glass - SEAM).abs().min(10.0),
            0.1 * prior(OPENING_PX).penalty(&fit.cone).min(30.0),
        ];
        let evidence = std::array::from_fn(|i| of_fit.get(i).copied().unwrap_or(0.0));
        let unexplained = fit.residual / variance;
        Self { fit, evidence, unexplained }
    }

    /// Fits the cone once more, to all that lies about it, and adds what that says.
    fn widen(&mut self, levels: &[Level], noise: f64) {
        let cone = &self.fit.cone;
        let (patch, variance) = cut_coarse(levels, noise, cone.x, cone.y, WIDE_PX, self.fit.unit);
        let near = Prior { mean: cone.to_array(), deviation: [2.0, 2.0, 0.05, 0.3, 0.3, 4.0, 0.3] };
        let Some(wide) = fit::fit(&patch, *cone, &near, variance, Seam::Without, 4) else { return };
        let clear = wide.mix[0].abs() / (wide.glass_error * wide.residual.sqrt()).max(f64::MIN_POSITIVE);
        let of_wide: [f64; OF_WIDE] = [
            wide.explained.max(-1.0),
            (wide.mix[0] / self.fit.mix[0]).clamp(-2.0, 4.0),
            (wide.cone.x - cone.x).hypot(wide.cone.y - cone.y).min(20.0),
            clear.max(0.1).ln(),
            (wide.residual / variance).ln().min(3.0),
        ];
        self.evidence[OF_FIT..].copy_from_slice(&of_wide);
    }

    /// How promising this is after a first look.
    fn promise(&self, (weights, bias): &Weights) -> f64 {
        bias + weights.iter().zip(&self.evidence).map(|(w, e)| w * e).sum::<f64>()
    }

    /// The logarithm of the odds that this is a pipette's tip, after the closest look.
    pub fn log_odds(&self) -> f64 {
        odds_of(&self.evidence)
    }
}

/// Radius of what lies about a pipette's end, px.
const WIDE_PX: f64 = 240.0;

pub fn prior(expected_opening_px: f64) -> Prior {
    let far = f64::INFINITY;
    Prior {
        mean: [0.0, 0.0, 0.0, expected_opening_px.ln(), 0.2_f64.ln(), 0.0, 0.65_f64.ln()],
        deviation: [far, far, far, 0.5, 0.4, 20.0, 0.5],
    }
}

/// Radius of an opening, as far as nothing is known of it.
const OPENING_PX: f64 = 3.0;

/// A pipette this many times as large as expected is looked at as if its pixels were finer.
const LARGE: f64 = 2.2;

/// Starts that are fitted at the first look.
const FITTED: usize = 10;

/// Candidates looked at from afar, then closer the best of them, focused above or below their tips; best first, those in one
/// place once.
pub fn coarse(levels: &[Level], noise: f64, candidates: &[Candidate]) -> Vec<Hypothesis> {
    let starts = candidates.iter().map(|c| Start { x: c.x, y: c.y, angle: c.angle });
    let afar: Vec<Hypothesis> = starts.filter_map(|start| afar(levels, noise, &start)).collect();
    let mut afar = best(afar, |h| h.promise(&AFAR));
    afar.truncate(FITTED);
    let level = &levels[2.min(levels.len() - 1)];
    let prior = prior(OPENING_PX);
    let variance = (noise / level.step as f64).powi(2);
    let closer = afar.iter().filter_map(|h| {
        let patch = Patch::cut(level, h.fit.cone.x, h.fit.cone.y, 80.0, 1.0);
        let fit = fit::fit(&patch, h.fit.cone, &prior, variance, Seam::Without, 4)?;
        Some(Hypothesis::new(levels, noise, variance, patch.mass, fit))
    });
    best(closer.collect(), |h| h.promise(&COARSE))
}

/// A place to begin at.
struct Start {
    x: f64,
    y: f64,
    angle: f64,
}

/// Blur radii of a tip to begin with, px.
const BLURS: [f64; 3] = [-16.0, -3.0, 10.0];

/// A look at a start, at the lowest resolution.
fn afar(levels: &[Level], noise: f64, start: &Start) -> Option<Hypothesis> {
    let (patch, variance) = cut_coarse(levels, noise, start.x, start.y, AFAR_PX, 1.0);
    let starts = BLURS.map(|blur| Cone {
        x: start.x,
        y: start.y,
        angle: start.angle,
        ln_opening: OPENING_PX.ln(),
        ln_widening: 0.2_f64.ln(),
        blur,
        ln_slope: 0.65_f64.ln(),
    });
    let gains = starts.map(|start| (fit::gain(&patch, &start), start));
    let (_, cone) = gains.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    let fit = fit::fit(&patch, cone, &prior(OPENING_PX), variance, Seam::Without, 4)?;
    Some(Hypothesis::new(levels, noise, variance, patch.mass, fit))
}

/// The patch about a place at the lowest resolution that shows enough pixels of it (a small picture shows fewer), and the
/// variance of such a pixel's noise.
fn cut_coarse(levels: &[Level], noise: f64, x: f64, y: f64, radius: f64, unit: f64) -> (Patch, f64) {
    let lowest = levels.len().min(4);
    let cut = |k: usize| (Patch::cut(&levels[k], x, y, radius, unit), (noise / levels[k].step as f64).powi(2));
    (1..lowest).rev().map(cut).find(|(patch, _)| patch.count >= ENOUGH_PIXELS).unwrap_or_else(|| cut(0))
}

/// Pixels that say enough of a pipette seen from afar.
const ENOUGH_PIXELS: usize = 70;

/// Radius of what is looked at from afar, px.
const AFAR_PX: f64 = 112.0;

/// Sorted by their odds; those in one place once.
fn best(mut found: Vec<Hypothesis>, odds: impl Fn(&Hypothesis) -> f64) -> Vec<Hypothesis> {
    found.sort_by(|a, b| odds(b).total_cmp(&odds(a)));
    distinct(found)
}

/// A closer look at hypotheses; best first.
pub fn fine(levels: &[Level], noise: f64, found: &[Hypothesis]) -> Vec<Hypothesis> {
    let prior = prior(OPENING_PX);
    let level = &levels[1.min(levels.len() - 1)];
    let variance = (noise / level.step as f64).powi(2);
    let better = found.iter().filter_map(|h| {
        let patch = Patch::cut(level, h.fit.cone.x, h.fit.cone.y, 64.0, 1.0);
        let mut fit = fit::fit(&patch, h.fit.cone, &prior, variance, Seam::With, 8)?;
        let opening = fit.cone.ln_opening.exp();
        if opening > LARGE * OPENING_PX {
            // A large pipette is looked at as a whole: the pixels are finer.
            let unit = opening / OPENING_PX;
            let (level, radius) =
                if opening > 2.0 * LARGE * OPENING_PX { (levels.get(2)?, 160.0) } else { (level, 100.0) };
            let patch = Patch::cut(level, fit.cone.x, fit.cone.y, radius, unit);
            let variance = (noise / level.step as f64).powi(2);
            fit = fit::fit(&patch, fit.cone, &prior, variance, Seam::With, 12)?;
            return Some(Hypothesis::new(levels, noise, variance, patch.mass, fit));
        }
        Some(Hypothesis::new(levels, noise, variance, patch.mass, fit))
    });
    let widened = better.map(|mut h: Hypothesis| {
        h.widen(levels, noise);
        h
    });
    best(widened.collect(), Hypothesis::log_odds)
}

/// A last look at a tip that is nearly in focus, at the picture's full detail.
pub fn polish(levels: &[Level], noise: f64, h: &Hypothesis) -> Option<Fit> {
    let cone = &h.fit.cone;
    let level = &levels[0];
    let sharp = cone.blur.abs() < SHARP_PX && h.fit.unit == 1.0;
    let patch = sharp.then(|| Patch::cut(level, cone.x, cone.y, 40.0, 1.0))?;
    let (prior, variance) = (usual(), (noise / level.step as f64).powi(2));
    // Blurred by as much on the other side of focus, a tip looks much the same.
    let mirrored = Cone { blur: -cone.blur, ..*cone };
    let cost = |fit: &Fit| patch.mass * fit.residual / variance + prior.penalty(&fit.cone);
    [*cone, mirrored]
        .into_iter()
        .filter_map(|start| fit::fit(&patch, start, &prior, variance, Seam::With, 7))
        .min_by(|a, b| cost(a).total_cmp(&cost(b)))
}

/// What patch pipettes mostly are: openings of 0.5 to 1.5 µm, cones of 5 to 12 degrees, descents of 25 to 60 degrees.
fn usual() -> Prior {
    let mut prior = prior(OPENING_PX);
    (prior.deviation[3], prior.deviation[4], prior.deviation[6]) = (0.36, 0.38, 0.42);
    prior
}

/// A tip blurred over less than this shows more at full detail, px.
const SHARP_PX: f64 = 9.0;

/// How far up the shank its direction is looked for, px.
const SHANK_PX: f64 = 90.0;

/// The direction of a clearly seen pipette by its shank: near the tip a real one is bent.
pub fn shank_angle(levels: &[Level], cone: &Cone, noise: f64) -> Option<f64> {
    let level = &levels[1.min(levels.len() - 1)];
    let variance = (noise / level.step as f64).powi(2);
    let back = SHANK_PX;
    let (sin, cos) = cone.angle.sin_cos();
    let patch = Patch::cut(level, cone.x - back * cos, cone.y - back * sin, 1.3 * back, 1.0);
    let fit = fit::fit(&patch, *cone, &prior(OPENING_PX), variance, Seam::With, 10)?;
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
