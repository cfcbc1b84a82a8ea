//! Fits a swinging pipette to a swing's picture.

use super::kernel::Kernel;
use super::model::{NUMBERS, Picture, Swinging};
use super::start;
use crate::tip::model::Cone;
use crate::tip::pyramid::Level;
use nalgebra::{SMatrix, SVector};

/// What was found, and how sure it is.
#[derive(Clone, Copy, Debug)]
pub struct Best {
    pub cone: Cone,
    /// Standard error of the tip along the pipette, px.
    pub error_along: f64,
    /// The picture's squares that the pipette explains, over what a pixel has that it does not explain.
    pub gain: f64,
}

impl Best {
    /// How likely it is that this is a tip, and within [`CLOSE_PX`].
    pub fn confidence(&self) -> f64 {
        let there = 1.0 / (1.0 + (0.5 * (LEAST_GAIN - self.gain)).exp());
        there / (1.0 + (self.error_along / CLOSE_PX).powi(4))
    }
}

/// A tip is known as well as it has to be within this, px.
const CLOSE_PX: f64 = 6.0;

/// Squares over noise that a pipette has to explain: its 11 numbers alone explain as many, and as they are looked for all over
/// the picture noise offers a few times as many.
const LEAST_GAIN: f64 = 60.0;

/// What is known of pipettes before looking: means and standard deviations, in the order of
/// [`Swinging::to_array`]; lengths at the still detector's pixel size. Openings of 0.5 to 1.5 µm, cones of 5 to 12 degrees, descents
/// of 25 to 60 degrees, and about the swing that a vibration has unless told otherwise.
const MEANS: [f64; NUMBERS] = [0.0, 0.0, 0.0, 1.1, -1.6, 0.0, -0.43, 1.8, 0.0, 2.5, 0.0];
const FREE: f64 = f64::INFINITY;
const DEVIATIONS: [f64; NUMBERS] = [FREE, FREE, FREE, 0.36, 0.38, 20.0, 0.42, 0.6, 0.3, 2.0, FREE];

/// The longest step of each number in one round.
const LEAPS: [f64; NUMBERS] = [20.0, 20.0, 0.3, 0.5, 0.5, 10.0, 0.5, 0.5, 0.3, 1.0, FREE];

/// Places that a fit begins at.
const STARTS: usize = 8;

/// What a pipette explains of the whole picture, at least, over what one can.
const HOLDS: f64 = 0.5;

/// Ways along the pipette and blurs of its tip that a closer look begins at, px at the still detector's pixel size; and how many
/// of the pipettes that come of these, for each kernel, are looked at closest.
const SHIFTS: [f64; 5] = [-24.0, -12.0, 0.0, 12.0, 24.0];
const BLURS: [f64; 6] = [-18.0, -9.0, -2.0, 5.0, 12.0, 20.0];
const CLOSER: usize = 3;

/// The pipette that explains most of a picture; `noise` is a standard deviation of one of its pixels. `None`: none does.
pub fn best(levels: &[Level], noise: f64, unit: f64, allowed: impl Fn(f64) -> bool) -> Option<Best> {
    let prior = Prior::new(unit);
    let typical = Swinging { depth: 1.0, ..Swinging::from_array(prior.mean) };
    let coarsest = levels.last()?;
    let coarse = Patch::whole(&levels[levels.len().saturating_sub(2)], noise, unit);
    let mut found: Vec<Fitted> = start::places(coarsest, unit, typical, STARTS, &allowed)
        .into_iter()
        .filter_map(|at| coarse.fit(&prior, at, 15))
        .filter(|f| allowed(f.at.cone.angle))
        .collect();
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    found.truncate(2);
    // Where a pipette ends along its axis has many a local best.
    let along = |f: &Fitted, shift: f64| {
        let (sin, cos) = f.at.cone.angle.sin_cos();
        let mut at = f.at;
        at.cone.x += shift * unit * cos;
        at.cone.y += shift * unit * sin;
        at
    };
    let shifted = found.iter().flat_map(|f| [-30.0, 30.0].map(|shift| along(f, shift)));
    let again: Vec<Fitted> = shifted.filter_map(|at| coarse.fit(&prior, at, 10)).collect();
    let best = found.into_iter().chain(again).min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    let gain = (coarse.squares - best.squares) / coarse.variance;
    // Nearer to the tip, once more from many pipettes there: the far shank alone is explained by wrong ones too.
    let near = Patch::about(levels.get(2).unwrap_or(coarsest), &best.at.cone, noise, unit);
    let mut closer: Vec<(Fitted, &'static Kernel)> = Vec::new();
    for kernel in Kernel::both() {
        let patch = Patch { kernel, ..near.clone() };
        let start = |blur: f64| {
            let started = SHIFTS.map(|shift| {
                let Cone { x, y, angle, .. } = along(&best, shift).cone;
                let mut at = Swinging::from_array(prior.mean);
                at.cone = Cone { x, y, angle, blur: blur * unit, ..at.cone };
                (patch.cost(&prior, &mut at).1, at)
            });
            started.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map(|s| s.1)
        };
        let starts = std::iter::once(best.at).chain(BLURS.into_iter().filter_map(start));
        let fitted = starts.filter_map(|at| patch.fit(&prior, at, 12)).collect();
        closer.extend(distinct(fitted, unit).into_iter().take(CLOSER).map(|f| (f, kernel)));
    }
    closer.sort_by(|a, b| a.0.cost.total_cmp(&b.0.cost));
    // At the resolution that its blur asks for.
    let cone = &closer.first()?.0.at.cone;
    let fine = if cone.blur.abs() > 10.0 * unit { 2 } else { 1 };
    let near = Patch::about(levels.get(fine)?, cone, noise, unit);
    let fitted = closer.iter().filter_map(|&(ref f, kernel)| {
        let patch = Patch { kernel, ..near.clone() };
        Some((patch.fit(&prior, f.at, 25)?, kernel))
    });
    let last: Vec<(Fitted, &'static Kernel)> = fitted.collect();
    let (last, kernel) = last.into_iter().min_by(|a, b| a.0.cost.total_cmp(&b.0.cost))?;
    let patch = Patch { kernel, ..Patch::about(levels.get(fine - 1)?, &last.at.cone, noise, unit) };
    let last = patch.fit(&prior, last.at, 10)?;
    let (sin, cos) = last.at.cone.angle.sin_cos();
    let c = &last.covariance;
    let along = c[(0, 0)] * cos * cos + 2.0 * c[(0, 1)] * sin * cos + c[(1, 1)] * sin * sin;
    // A shank whose tip is not seen can be explained near some place by a pipette that ends there, but not as a whole.
    let (whole, _) = coarse.squares_and_depth(&last.at);
    if coarse.squares - whole < HOLDS * (coarse.squares - best.squares) {
        return None;
    }
    // What is left is noise, or more where the pipette is none or is not all that swings.
    let left = (last.squares / (patch.variance * patch.mass)).max(1.0);
    Some(Best { cone: last.at.cone, error_along: (along.max(0.0) * left).sqrt(), gain: gain / left })
}

/// Best first, those that are the same once.
fn distinct(mut fitted: Vec<Fitted>, unit: f64) -> Vec<Fitted> {
    fitted.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut kept: Vec<Fitted> = Vec::new();
    for f in fitted {
        let same = |k: &Fitted| {
            let (one, other) = (&k.at.cone, &f.at.cone);
            (one.x - other.x).hypot(one.y - other.y) < SAME_PX * unit && (one.blur - other.blur).abs() < SAME_PX * unit
        };
        if !kept.iter().any(same) {
            kept.push(f);
        }
    }
    kept
}

/// Pipettes whose places and blurs differ by less are the same, px at the still detector's pixel size.
const SAME_PX: f64 = 1.5;

struct Prior {
    mean: [f64; NUMBERS],
    deviation: [f64; NUMBERS],
}

impl Prior {
    fn new(unit: f64) -> Self {
        let (mut mean, mut deviation) = (MEANS, DEVIATIONS);
        mean[3] += unit.ln();
        mean[7] += unit.ln();
        deviation[5] *= unit;
        Self { mean, deviation }
    }

    fn penalty(&self, numbers: &[f64; NUMBERS]) -> f64 {
        (0..NUMBERS).map(|i| ((numbers[i] - self.mean[i]) / self.deviation[i]).powi(2)).sum()
    }
}

#[derive(Clone, Copy)]
struct Sample {
    x: f32,
    y: f32,
    value: f32,
    weight: f32,
}

/// Pixels that are fitted.
#[derive(Clone)]
struct Patch {
    origin: [f64; 2],
    step: f64,
    unit: f64,
    samples: Vec<Sample>,
    /// Of a pixel's noise.
    variance: f64,
    /// Sums of the weights, and of the weighted squares.
    mass: f64,
    squares: f64,
    kernel: &'static Kernel,
}

struct Fitted {
    at: Swinging,
    squares: f64,
    /// Squares over the noise's variance, with the prior's.
    cost: f64,
    covariance: SMatrix<f64, NUMBERS, NUMBERS>,
}

/// Pixels farther than this from a tip, less what its blur asks for, say little of where it is, px at the still detector's size.
const REACH_PX: f64 = 90.0;

impl Patch {
    fn whole(level: &Level, noise: f64, unit: f64) -> Self {
        Self::new(level, [0.0, 0.0], noise, unit, |_, _| 1.0)
    }

    fn about(level: &Level, cone: &Cone, noise: f64, unit: f64) -> Self {
        let reach = (REACH_PX + 2.0 * (cone.blur / unit).abs().min(40.0)) * unit;
        Self::new(level, [cone.x, cone.y], noise, unit, |x, y| {
            let share = (x * x + y * y) / (reach * reach);
            (1.0 - share * share).max(0.0)
        })
    }

    fn new(level: &Level, origin: [f64; 2], noise: f64, unit: f64, weight: impl Fn(f64, f64) -> f64) -> Self {
        let mut samples = Vec::new();
        let (mut mass, mut squares) = (0.0, 0.0);
        for (j, row) in level.values.chunks_exact(level.width).enumerate() {
            let y = level.picture_px(j) - origin[1];
            for (i, value) in row.iter().enumerate() {
                let x = level.picture_px(i) - origin[0];
                let weight = weight(x, y);
                if weight > 0.0 {
                    mass += weight;
                    squares += weight * f64::from(*value).powi(2);
                    samples.push(Sample { x: x as f32, y: y as f32, value: *value, weight: weight as f32 });
                }
            }
        }
        let step = level.step as f64;
        let variance = (noise / step).powi(2);
        Self { origin, step, unit, samples, variance, mass, squares, kernel: Kernel::both()[0] }
    }

    fn picture(&self, at: &Swinging) -> Picture {
        Picture::new(at, self.kernel, self.step, self.origin, self.unit)
    }

    /// The weighted squares that a pipette leaves, and the depth that leaves the least.
    fn squares_and_depth(&self, at: &Swinging) -> (f64, f64) {
        let picture = self.picture(at);
        let (mut both, mut own) = (0.0, 0.0);
        for s in &self.samples {
            let shape = picture.shape(s.x, s.y);
            both += f64::from(s.weight * shape * s.value);
            own += f64::from(s.weight * shape * shape);
        }
        if own > 0.0 { (self.squares - both * both / own, both / own) } else { (self.squares, 0.0) }
    }

    fn cost(&self, prior: &Prior, at: &mut Swinging) -> (f64, f64) {
        let (squares, depth) = self.squares_and_depth(at);
        at.depth = depth;
        (squares, squares / self.variance + prior.penalty(&at.to_array()))
    }

    /// By Levenberg and Marquardt's method, at most `rounds` steps.
    fn fit(&self, prior: &Prior, start: Swinging, rounds: usize) -> Option<Fitted> {
        type Square = SMatrix<f64, NUMBERS, NUMBERS>;
        let mut at = start;
        let (mut squares, mut cost) = self.cost(prior, &mut at);
        let mut damping = 1e-2;
        let mut normal = Square::zeros();
        for _ in 0..rounds {
            let picture = self.picture(&at);
            normal = Square::zeros();
            let mut right = SVector::<f64, NUMBERS>::zeros();
            for s in &self.samples {
                let (value, slopes) = picture.value_and_slopes(s.x, s.y);
                if value == 0.0 {
                    continue;
                }
                let r = f64::from(s.weight * (s.value - value));
                for i in 0..NUMBERS {
                    let wi = f64::from(s.weight * slopes[i]);
                    right[i] += r * f64::from(slopes[i]);
                    for j in 0..=i {
                        normal[(i, j)] += wi * f64::from(slopes[j]);
                    }
                }
            }
            normal /= self.variance;
            right /= self.variance;
            let numbers = at.to_array();
            for i in 0..NUMBERS {
                for j in 0..i {
                    normal[(j, i)] = normal[(i, j)];
                }
                normal[(i, i)] += prior.deviation[i].powi(-2);
                right[i] -= (numbers[i] - prior.mean[i]) * prior.deviation[i].powi(-2);
            }
            let before = cost;
            for _ in 0..6 {
                let mut damped = normal;
                for i in 0..NUMBERS {
                    damped[(i, i)] = damped[(i, i)] * (1.0 + damping) + 1e-12;
                }
                let Some(step) = damped.cholesky().map(|c| c.solve(&right)) else {
                    damping *= 10.0;
                    continue;
                };
                let mut next = Swinging::from_array(std::array::from_fn(|i| {
                    let leap = LEAPS[i] * if i < 2 || i == 5 { self.unit } else { 1.0 };
                    numbers[i] + step[i].clamp(-leap, leap)
                }));
                let (next_squares, next_cost) = self.cost(prior, &mut next);
                if next_cost < cost {
                    (at, squares, cost) = (next, next_squares, next_cost);
                    damping = (damping * 0.2).max(1e-6);
                    break;
                }
                damping *= 6.0;
            }
            if before - cost < 0.03 {
                break;
            }
        }
        let covariance = normal.cholesky()?.inverse();
        Some(Fitted { at, squares, cost, covariance })
    }
}
