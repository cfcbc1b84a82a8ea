//! Fits a pipette's end to the pixels about it.

#![allow(clippy::needless_range_loop, reason = "lanes of several arrays, side by side")]

use super::drawn::{Drawn, Places, Seam};
use super::model::{Cone, GLASS, PLACES, SEAM_DEVIATION};
use super::patch::{LANES, Lanes, Patch};

/// Pixels that a fit needs at least.
const LEAST_PIXELS: usize = 52;

/// A fitted pipette.
#[derive(Clone, Debug)]
pub struct Fit {
    pub cone: Cone,
    /// As the patch's.
    pub unit: f64,
    pub mix: [f64; GLASS],
    /// Weighted mean of the squared residuals.
    pub residual: f64,
    /// The same without any pipette: level and slopes of the light alone.
    pub empty: f64,
    /// The share of the squares that the cone explains, where what does not look like one counts less.
    pub explained: f64,
    /// Standard error of the glass's share of the mix, in standard deviations of a pixel's noise.
    pub glass_error: f64,
    /// Standard errors of the tip along and across the pipette, px.
    pub error_along: f64,
    pub error_across: f64,
}

/// What is known of pipettes before looking: mean and standard deviation of each of a cone's numbers (an infinite one: nothing).
#[derive(Clone, Copy, Debug)]
pub struct Prior {
    pub mean: [f64; PLACES],
    pub deviation: [f64; PLACES],
}

impl Prior {
    pub fn penalty(&self, cone: &Cone) -> f64 {
        let p = cone.to_array();
        (0..PLACES).map(|i| ((p[i] - self.mean[i]) / self.deviation[i]).powi(2)).sum()
    }
}

/// The longest step of each number of an [`Anchored`] cone in one round.
const LEAP: [f64; PLACES] = [12.0, 12.0, 0.3, 4.0, 0.5, 8.0, 0.5];

/// The smallest opening, px.
const LEAST_OPENING: f64 = 0.3;

/// A cone described by its width and blur at a fixed place on the shank. There the picture determines them; at the tip they
/// follow from where it ends, so that fits need not creep along a curved valley.
struct Anchored {
    /// The fixed place, px.
    at: [f64; 2],
    numbers: [f64; PLACES],
}

impl Anchored {
    fn new(cone: &Cone, at: [f64; 2]) -> Self {
        let mut numbers = cone.to_array();
        let back = distance(cone.x, cone.y, cone.angle, at);
        numbers[3] = cone.ln_opening.exp() + cone.ln_widening.exp() * back;
        numbers[5] = cone.blur + cone.ln_slope.exp() * back;
        Self { at, numbers }
    }

    fn cone(&self) -> Cone {
        let [x, y, angle, half, ln_widening, blur, ln_slope] = self.numbers;
        let back = distance(x, y, angle, self.at);
        let opening = (half - ln_widening.exp() * back).max(LEAST_OPENING);
        let blur = blur - ln_slope.exp() * back;
        Cone { x, y, angle, ln_opening: opening.ln(), ln_widening, blur, ln_slope }
    }

    /// How a cone's numbers change with these.
    fn jacobian(&self) -> Places {
        let cone = self.cone();
        let back = distance(cone.x, cone.y, cone.angle, self.at);
        let (sin, cos) = cone.angle.sin_cos();
        let (opening, widening, slope) = (cone.ln_opening.exp(), cone.ln_widening.exp(), cone.ln_slope.exp());
        let mut j = Places::identity();
        let free = if opening > LEAST_OPENING { 1.0 / opening } else { 0.0 };
        for (k, d) in [(0, -widening * cos), (1, -widening * sin), (3, 1.0), (4, -widening * back)] {
            j[(3, k)] = d * free;
        }
        for (k, d) in [(0, -slope * cos), (1, -slope * sin), (6, -slope * back)] {
            j[(5, k)] = d;
        }
        j
    }
}

/// From a place on the shank to the tip, along the pipette.
fn distance(x: f64, y: f64, angle: f64, from: [f64; 2]) -> f64 {
    (x - from[0]) * angle.cos() + (y - from[1]) * angle.sin()
}

/// How much likelier a cone makes a patch than light alone does: the logarithm of the squares' ratio, for all its pixels.
pub fn gain(patch: &Patch, cone: &Cone) -> f64 {
    let drawn = Drawn::new(patch, cone, &patch.weights(), Seam::Without, 0.0);
    patch.mass * (patch.empty / drawn.squares.max(1e-12)).max(1.0).ln()
}

/// Fits by Levenberg and Marquardt's method, at most `rounds` steps. `variance`: of a pixel's noise, at least. `None` where
/// the patch holds too few pixels.
pub fn fit(patch: &Patch, start: Cone, prior: &Prior, variance: f64, seam: Seam, rounds: usize) -> Option<Fit> {
    if patch.count < LEAST_PIXELS {
        return None;
    }
    let base = patch.weights();
    let mut weights = base.clone();
    let mut at = start;
    // At first the seam is as it mostly is.
    let mut stiffness = patch.mass;
    let mut now = Drawn::new(patch, &at, &weights, seam, stiffness);
    let back = 0.4 * f64::from(patch.radius);
    let anchor = [start.x - back * start.angle.cos(), start.y - back * start.angle.sin()];
    if seam == Seam::With {
        // Where the pipette ends along its axis has many a local best.
        let anchored = Anchored::new(&at, anchor);
        let (sin, cos) = at.angle.sin_cos();
        let mut best = f64::INFINITY;
        for i in -2..=3 {
            let shift = f64::from(i) * 0.1 * f64::from(patch.radius);
            let mut numbers = anchored.numbers;
            numbers[0] += shift * cos;
            numbers[1] += shift * sin;
            let cone = Anchored { at: anchor, numbers }.cone();
            let drawn = Drawn::new(patch, &cone, &weights, seam, stiffness);
            if drawn.cost < best {
                best = drawn.cost;
                at = cone;
                now = drawn;
            }
        }
    }
    let mut damping = 1e-2;
    let mut normal = Places::zeros();
    for round in 0..rounds {
        reweigh(&now.residuals, &base, patch.count, variance, &mut weights);
        let noise = (now.squares / patch.mass).max(variance);
        stiffness = noise / (SEAM_DEVIATION * now.mix[0]).powi(2).max(noise);
        now.solve(patch, &weights, stiffness);
        let params = at.to_array();
        let equations = now.equations(patch, &at, &weights);
        normal = equations.normal / noise;
        let mut right = equations.right / noise;
        for i in 0..PLACES {
            normal[(i, i)] += prior.deviation[i].powi(-2);
            right[i] -= (params[i] - prior.mean[i]) * prior.deviation[i].powi(-2);
        }
        let anchored = Anchored::new(&at, anchor);
        let jacobian = anchored.jacobian();
        let bent = jacobian.transpose() * normal * jacobian;
        let right = jacobian.transpose() * right;
        let cost = now.cost / noise + prior.penalty(&at);
        let mut moved = 0.0;
        for _ in 0..4 {
            let mut damped = bent;
            for i in 0..PLACES {
                damped[(i, i)] = damped[(i, i)] * (1.0 + damping) + 1e-9;
            }
            let Some(step) = damped.cholesky().map(|c| c.solve(&right)) else {
                damping *= 10.0;
                continue;
            };
            let numbers = std::array::from_fn(|i| anchored.numbers[i] + step[i].clamp(-LEAP[i], LEAP[i]));
            let cone = Anchored { at: anchor, numbers }.cone();
            let next = Drawn::new(patch, &cone, &weights, seam, stiffness);
            if next.cost / noise + prior.penalty(&cone) < cost {
                moved = (cone.x - at.x).hypot(cone.y - at.y);
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
    let mut squares = 0.0;
    for (residual, base) in now.residuals.iter().zip(&base) {
        squares += (0..LANES).map(|l| f64::from(base[l] * residual[l] * residual[l])).sum::<f64>();
    }
    let covariance = normal.cholesky().map_or_else(Places::zeros, |c| c.inverse());
    let (sin, cos) = at.angle.sin_cos();
    let (xx, xy, yy) = (covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]);
    Some(Fit {
        cone: at,
        unit: patch.unit,
        explained: 1.0 - now.squares / now.empty_squares().max(1e-12),
        glass_error: now.glass_error(),
        mix: now.shares(),
        residual: squares / patch.mass,
        empty: patch.empty / patch.mass,
        error_along: (xx * cos * cos + 2.0 * xy * sin * cos + yy * sin * sin).max(0.0).sqrt(),
        error_across: (xx * sin * sin - 2.0 * xy * sin * cos + yy * cos * cos).max(0.0).sqrt(),
    })
}

/// What does not look like a pipette (a cell beside it) counts less: Cauchy's weights about the typical residual.
fn reweigh(residuals: &[Lanes], base: &[Lanes], count: usize, variance: f64, weights: &mut [Lanes]) {
    let mut sizes: Vec<f32> = residuals.iter().flatten().take(count).map(|r| r.abs()).collect();
    let middle = sizes.len() / 2;
    let typical = 1.48 * *sizes.select_nth_unstable_by(middle, f32::total_cmp).1;
    let limit = 6.25 * (typical * typical).max(variance as f32).max(f32::MIN_POSITIVE);
    for ((w, b), r) in weights.iter_mut().zip(base).zip(residuals) {
        for l in 0..LANES {
            w[l] = b[l] / (1.0 + r[l] * r[l] / limit);
        }
    }
}
