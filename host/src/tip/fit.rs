//! Fits a pipette's end to the pixels about it.

use super::model::{Cone, Drawing, PLACES, SHAPES};
use super::pyramid::Level;
use nalgebra::{SMatrix, SVector};

/// The pixels of a disc, with their weights.
#[derive(Debug)]
pub struct Patch {
    pub x: f64,
    pub y: f64,
    pub radius: f64,
    pub step: f64,
    pub samples: Vec<Sample>,
}

#[derive(Clone, Copy, Debug)]
pub struct Sample {
    pub x: f64,
    pub y: f64,
    pub value: f64,
    pub weight: f64,
}

impl Patch {
    /// The pixels of `level` within `radius` px of (`x`, `y`), px of the picture; those in the middle count most.
    pub fn cut(level: &Level, x: f64, y: f64, radius: f64) -> Self {
        let step = level.step as f64;
        let range = |c: f64, n: usize| {
            let low = ((c - radius) / step).ceil().max(0.0) as usize;
            let high = ((c + radius) / step).floor().max(0.0) as usize;
            low.min(n)..(high + 1).min(n)
        };
        let columns = range(x, level.width);
        let mut samples = Vec::with_capacity(columns.len() * columns.len());
        for j in range(y, level.height) {
            let py = level.picture_px(j);
            for i in columns.clone() {
                let px = level.picture_px(i);
                let d2 = ((px - x).powi(2) + (py - y).powi(2)) / (radius * radius);
                if d2 < 1.0 {
                    let value = f64::from(level.values[j * level.width + i]);
                    samples.push(Sample { x: px, y: py, value, weight: (1.0 - d2).powi(2) });
                }
            }
        }
        Self { x, y, radius, step, samples }
    }
}

/// A fitted pipette.
#[derive(Clone, Debug)]
pub struct Fit {
    pub cone: Cone,
    pub mix: [f64; SHAPES],
    /// Weighted sum of squared residuals over the sum of weights.
    pub residual: f64,
    /// The same without any pipette: level and slopes of the light alone.
    pub empty: f64,
    /// Standard errors of the tip along and across the pipette, px.
    pub error_along: f64,
    pub error_across: f64,
}

type Normal = SMatrix<f64, SHAPES, SHAPES>;
type Mix = SVector<f64, SHAPES>;

struct Projected {
    mix: Mix,
    /// Weighted squared residuals, priors not included.
    squares: f64,
}

/// What is known of pipettes before looking: mean and standard deviation of each of a cone's numbers (an infinite one: nothing).
#[derive(Clone, Copy, Debug)]
pub struct Prior {
    pub mean: [f64; PLACES],
    pub deviation: [f64; PLACES],
}

fn project(patch: &Patch, cone: Cone, weights: &[f64]) -> Projected {
    let drawing = Drawing::new(cone, patch.step, patch.radius);
    let mut normal = Normal::zeros();
    let mut right = Mix::zeros();
    let mut total = 0.0;
    for (sample, w) in patch.samples.iter().zip(weights) {
        let shapes = drawing.shapes(sample.x, sample.y);
        for i in 0..SHAPES {
            let wi = w * shapes[i];
            right[i] += wi * sample.value;
            for j in 0..=i {
                normal[(i, j)] += wi * shapes[j];
            }
        }
        total += w * sample.value * sample.value;
    }
    normal.fill_upper_triangle_with_lower_triangle();
    // Shapes that look alike when blurred share the light evenly.
    let ridge = 1e-4 * normal[(4, 4)].max(1e-12);
    for i in 0..4 {
        normal[(i, i)] += ridge;
    }
    let mix = normal.cholesky().map_or_else(Mix::zeros, |c| c.solve(&right));
    Projected { mix, squares: (total - mix.dot(&right)).max(0.0) }
}

fn residuals(patch: &Patch, cone: Cone, mix: &Mix) -> Vec<f64> {
    let drawing = Drawing::new(cone, patch.step, patch.radius);
    patch
        .samples
        .iter()
        .map(|s| {
            let shapes = drawing.shapes(s.x, s.y);
            s.value - shapes.iter().zip(mix.iter()).map(|(a, b)| a * b).sum::<f64>()
        })
        .collect()
}

/// Steps of the numeric derivatives.
const NUDGE: [f64; PLACES] = [0.05, 0.05, 2e-3, 0.01, 0.01, 0.1, 0.01];

/// Fits by Levenberg and Marquardt's method, at most `rounds` steps. `variance`: of a pixel's noise, at least.
pub fn fit(patch: &Patch, start: Cone, prior: &Prior, variance: f64, rounds: usize) -> Option<Fit> {
    if patch.samples.len() < 4 * (PLACES + SHAPES) {
        return None;
    }
    let base: Vec<f64> = patch.samples.iter().map(|s| s.weight).collect();
    let mass: f64 = base.iter().sum();
    let mut weights = base.clone();
    let mut at = start;
    let mut now = project(patch, at, &weights);
    let penalty = |c: Cone| -> f64 {
        let p = c.to_array();
        (0..PLACES).map(|i| ((p[i] - prior.mean[i]) / prior.deviation[i]).powi(2)).sum()
    };
    let mut damping = 1e-2;
    let mut normal = SMatrix::<f64, PLACES, PLACES>::zeros();
    for round in 0..rounds {
        let r0 = residuals(patch, at, &now.mix);
        // What does not look like a pipette (a cell beside it) counts less: Cauchy's weights about the typical residual.
        let mut sorted: Vec<f64> = r0.iter().map(|r| r.abs()).collect();
        let middle = sorted.len() / 2;
        let typical = *sorted.select_nth_unstable_by(middle, f64::total_cmp).1 * 1.48;
        let scale2 = (6.25 * typical * typical).max(6.25 * variance);
        for ((w, b), r) in weights.iter_mut().zip(&base).zip(&r0) {
            *w = b / (1.0 + r * r / scale2);
        }
        now = project(patch, at, &weights);
        let r0 = residuals(patch, at, &now.mix);
        let noise = (now.squares / mass).max(variance);
        let params = at.to_array();
        let mut columns: Vec<Vec<f64>> = Vec::with_capacity(PLACES);
        for k in 0..PLACES {
            let mut p = params;
            p[k] += NUDGE[k];
            let cone = Cone::from_array(p);
            let mix = project(patch, cone, &weights).mix;
            let r = residuals(patch, cone, &mix);
            columns.push(r.iter().zip(&r0).map(|(a, b)| (a - b) / NUDGE[k]).collect());
        }
        normal.fill(0.0);
        let mut right = SVector::<f64, PLACES>::zeros();
        for i in 0..PLACES {
            for j in 0..=i {
                normal[(i, j)] =
                    columns[i].iter().zip(&columns[j]).zip(&weights).map(|((a, b), w)| a * b * w).sum::<f64>() / noise;
            }
            right[i] = -columns[i].iter().zip(&r0).zip(&weights).map(|((a, r), w)| a * r * w).sum::<f64>() / noise;
            normal[(i, i)] += prior.deviation[i].powi(-2);
            right[i] -= (params[i] - prior.mean[i]) * prior.deviation[i].powi(-2);
        }
        normal.fill_upper_triangle_with_lower_triangle();
        let cost = now.squares / noise + penalty(at);
        let mut moved = 0.0;
        for _ in 0..5 {
            let mut damped = normal;
            for i in 0..PLACES {
                damped[(i, i)] *= 1.0 + damping;
            }
            let Some(step) = damped.cholesky().map(|c| c.solve(&right)) else {
                damping *= 10.0;
                continue;
            };
            let mut p = params;
            for i in 0..PLACES {
                p[i] += step[i].clamp(-LEAP[i], LEAP[i]);
            }
            let cone = Cone::from_array(p);
            let next = project(patch, cone, &weights);
            if next.squares / noise + penalty(cone) < cost {
                moved = (p[0] - at.x).hypot(p[1] - at.y);
                at = cone;
                now = next;
                damping = (damping * 0.2).max(1e-5);
                break;
            }
            damping *= 8.0;
        }
        if moved < 0.01 && round > 2 {
            break;
        }
    }
    let empty = empty_residual(patch, &base, mass);
    let r = residuals(patch, at, &now.mix);
    let residual = r.iter().zip(&base).map(|(r, b)| b * r * r).sum::<f64>() / mass;
    let covariance = normal.cholesky()?.inverse();
    let (sin, cos) = at.angle.sin_cos();
    let along = covariance[(0, 0)] * cos * cos + 2.0 * covariance[(0, 1)] * sin * cos + covariance[(1, 1)] * sin * sin;
    let across = covariance[(0, 0)] * sin * sin - 2.0 * covariance[(0, 1)] * sin * cos + covariance[(1, 1)] * cos * cos;
    let mix = now.mix.into();
    Some(Fit { cone: at, mix, residual, empty, error_along: along.max(0.0).sqrt(), error_across: across.max(0.0).sqrt() })
}

/// The longest step of each number in one round.
const LEAP: [f64; PLACES] = [12.0, 12.0, 0.3, 0.5, 0.5, 8.0, 0.5];

fn empty_residual(patch: &Patch, weights: &[f64], mass: f64) -> f64 {
    let mut normal = SMatrix::<f64, 3, 3>::zeros();
    let mut right = SVector::<f64, 3>::zeros();
    let mut total = 0.0;
    for (s, w) in patch.samples.iter().zip(weights) {
        let v = SVector::<f64, 3>::new(1.0, (s.x - patch.x) / patch.radius, (s.y - patch.y) / patch.radius);
        normal += v * v.transpose() * *w;
        right += v * (w * s.value);
        total += w * s.value * s.value;
    }
    normal.cholesky().map_or(0.0, |c| (total - c.solve(&right).dot(&right)).max(0.0)) / mass
}
