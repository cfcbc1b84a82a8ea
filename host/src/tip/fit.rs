//! Fits a pipette's end to the pixels about it.

use super::model::{Cone, Drawing, GLASS, PLACES};
use super::pyramid::Level;
use nalgebra::{SMatrix, SVector};

/// Shapes that mix linearly: the pipette's, and the light's level and two slopes.
const SHAPES: usize = GLASS + 3;

/// The pixels of a disc, with their weights.
#[derive(Debug)]
pub struct Patch {
    x: f64,
    y: f64,
    step: f64,
    /// How many times finer than the model's optics a pixel is.
    unit: f64,
    radius: f32,
    samples: Vec<Sample>,
    /// Sum of the weights.
    pub mass: f64,
}

/// A pixel: its place from the patch's middle, its value and its weight.
#[derive(Clone, Copy, Debug)]
struct Sample {
    x: f32,
    y: f32,
    value: f32,
    weight: f32,
}

impl Patch {
    /// The pixels of `level` within `radius` px of (`x`, `y`), px of the picture; those in the middle count most.
    pub fn cut(level: &Level, x: f64, y: f64, radius: f64, unit: f64) -> Self {
        let step = level.step as f64;
        let range = |c: f64, n: usize| {
            let low = ((c - radius) / step).ceil().max(0.0) as usize;
            let high = ((c + radius) / step).floor().max(0.0) as usize;
            low.min(n)..(high + 1).min(n)
        };
        let columns = range(x, level.width);
        let mut samples = Vec::with_capacity(columns.len() * columns.len());
        let mut mass = 0.0;
        for j in range(y, level.height) {
            let dy = level.picture_px(j) - y;
            for i in columns.clone() {
                let dx = level.picture_px(i) - x;
                let share = (dx * dx + dy * dy) / (radius * radius);
                if share < 1.0 {
                    let value = level.values[j * level.width + i];
                    let weight = (1.0 - share).powi(2);
                    mass += weight;
                    samples.push(Sample { x: dx as f32, y: dy as f32, value, weight: weight as f32 });
                }
            }
        }
        Self { x, y, step, unit, radius: radius as f32, samples, mass }
    }
}

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
    fn penalty(&self, cone: &Cone) -> f64 {
        let p = cone.to_array();
        (0..PLACES).map(|i| ((p[i] - self.mean[i]) / self.deviation[i]).powi(2)).sum()
    }
}

type Shapes = SMatrix<f64, SHAPES, SHAPES>;
type Mix = SVector<f64, SHAPES>;
type Places = SMatrix<f64, PLACES, PLACES>;

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

/// All shapes at all samples of a patch, for one cone.
struct Drawn {
    rows: Vec<[f32; SHAPES]>,
    mix: Mix,
    squares: f64,
    inverse: Shapes,
    seam: Seam,
}

/// How freely the seam joins the mix. Left free from the start it takes the glass's part and the fit ends in a wrong place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seam {
    Without,
    With,
}

impl Drawn {
    fn new(patch: &Patch, cone: &Cone, weights: &[f32], seam: Seam) -> Self {
        let drawing = Drawing::new(cone, patch.step, [patch.x, patch.y], patch.unit);
        let inverse = 1.0 / patch.radius;
        let rows = patch
            .samples
            .iter()
            .map(|s| {
                let [glass, lumen, seam] = drawing.shapes(s.x, s.y);
                [glass, lumen, seam, 1.0, s.x * inverse, s.y * inverse]
            })
            .collect();
        let mut drawn = Self { rows, mix: Mix::zeros(), squares: 0.0, inverse: Shapes::zeros(), seam };
        drawn.solve(patch, weights);
        drawn
    }

    /// Mixes the shapes for the least weighted squares.
    fn solve(&mut self, patch: &Patch, weights: &[f32]) {
        let mut normal = [[0.0_f64; SHAPES]; SHAPES];
        let mut right = [0.0_f64; SHAPES];
        let mut total = 0.0;
        for ((row, sample), w) in self.rows.iter().zip(&patch.samples).zip(weights) {
            for i in 0..SHAPES {
                let wi = f64::from(w * row[i]);
                right[i] += wi * f64::from(sample.value);
                for j in 0..=i {
                    normal[i][j] += wi * f64::from(row[j]);
                }
            }
            total += f64::from(w * sample.value * sample.value);
        }
        let mut matrix = Shapes::from_fn(|i, j| if j <= i { normal[i][j] } else { normal[j][i] });
        // Shapes that look alike when blurred share the light evenly.
        let ridge = 1e-4 * normal[GLASS][GLASS].max(1e-12);
        let seam = match self.seam {
            Seam::Without => 1e9,
            Seam::With => 1.0,
        };
        for (i, factor) in [1.0, 30.0, seam].into_iter().enumerate() {
            matrix[(i, i)] += factor * ridge;
        }
        let right = Mix::from(right);
        self.inverse = matrix.cholesky().map_or_else(Shapes::zeros, |c| c.inverse());
        self.mix = self.inverse * right;
        self.squares = (total - self.mix.dot(&right)).max(0.0);
    }

    fn residuals(&self, patch: &Patch) -> Vec<f32> {
        let mix: [f32; SHAPES] = std::array::from_fn(|i| self.mix[i] as f32);
        let drawn = self.rows.iter().map(|row| row.iter().zip(&mix).map(|(a, b)| a * b).sum::<f32>());
        patch.samples.iter().zip(drawn).map(|(s, d)| s.value - d).collect()
    }

    /// Derivatives of the residuals by the cone's numbers, the mix following along (Kaufman 1975).
    fn derivatives(&self, patch: &Patch, cone: &Cone, weights: &[f32]) -> Vec<[f32; LANES]> {
        let drawing = Drawing::new(cone, patch.step, [patch.x, patch.y], patch.unit);
        let mix: [f32; GLASS] = std::array::from_fn(|i| self.mix[i] as f32);
        let mut shared = [[0.0_f32; LANES]; SHAPES];
        let mut all: Vec<[f32; LANES]> = Vec::with_capacity(patch.samples.len());
        for ((s, row), w) in patch.samples.iter().zip(&self.rows).zip(weights) {
            let [a, b, c, d, e, f, g] = drawing.slopes(s.x, s.y, &mix);
            let slopes = [-a, -b, -c, -d, -e, -f, -g, 0.0];
            for (shared, shape) in shared.iter_mut().zip(row) {
                let share = w * shape;
                for (sum, slope) in shared.iter_mut().zip(&slopes) {
                    *sum += share * slope;
                }
            }
            all.push(slopes);
        }
        let shared = SMatrix::<f64, SHAPES, LANES>::from_fn(|i, k| f64::from(shared[i][k]));
        let along = self.inverse * shared;
        let along: [[f32; LANES]; SHAPES] = std::array::from_fn(|i| std::array::from_fn(|k| along[(i, k)] as f32));
        for (slopes, row) in all.iter_mut().zip(&self.rows) {
            for (shape, along) in row.iter().zip(&along) {
                for (slope, along) in slopes.iter_mut().zip(along) {
                    *slope -= shape * along;
                }
            }
        }
        all
    }
}

/// Lanes of a row of derivatives: one more than a cone has numbers, so that they fill whole registers.
const LANES: usize = 8;

/// How much likelier a cone makes a patch than light alone does: the logarithm of the squares' ratio, for all its pixels.
pub fn gain(patch: &Patch, cone: &Cone) -> f64 {
    let base: Vec<f32> = patch.samples.iter().map(|s| s.weight).collect();
    let drawn = Drawn::new(patch, cone, &base, Seam::Without);
    patch.mass * (empty_residual(patch) / drawn.squares.max(1e-12)).max(1.0).ln()
}

/// Fits by Levenberg and Marquardt's method, at most `rounds` steps. `variance`: of a pixel's noise, at least. `None` where
/// the patch holds too few pixels.
pub fn fit(patch: &Patch, start: Cone, prior: &Prior, variance: f64, seam: Seam, rounds: usize) -> Option<Fit> {
    if patch.samples.len() < 4 * (PLACES + SHAPES) {
        return None;
    }
    let base: Vec<f32> = patch.samples.iter().map(|s| s.weight).collect();
    let mut weights = base.clone();
    let mut at = start;
    let mut now = Drawn::new(patch, &at, &weights, seam);
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
            let drawn = Drawn::new(patch, &cone, &weights, seam);
            if drawn.squares < best {
                best = drawn.squares;
                at = cone;
                now = drawn;
            }
        }
    }
    let mut damping = 1e-2;
    let mut normal = Places::zeros();
    for round in 0..rounds {
        reweigh(&now.residuals(patch), &base, variance, &mut weights);
        now.solve(patch, &weights);
        let residuals = now.residuals(patch);
        let slopes = now.derivatives(patch, &at, &weights);
        let noise = (now.squares / patch.mass).max(variance);
        let params = at.to_array();
        let mut pull = [0.0_f32; LANES];
        let mut sums = [[0.0_f32; LANES]; PLACES];
        for ((d, r), w) in slopes.iter().zip(&residuals).zip(&weights) {
            let wr = w * r;
            for (sum, slope) in pull.iter_mut().zip(d) {
                *sum -= wr * slope;
            }
            for (sums, slope) in sums.iter_mut().zip(d) {
                let share = w * slope;
                for (sum, slope) in sums.iter_mut().zip(d) {
                    *sum += share * slope;
                }
            }
        }
        let mut right = SVector::<f64, PLACES>::from_fn(|i, _| f64::from(pull[i]));
        normal = Places::from_fn(|i, j| f64::from(sums[i.max(j)][i.min(j)]) / noise);
        right /= noise;
        for i in 0..PLACES {
            normal[(i, i)] += prior.deviation[i].powi(-2);
            right[i] -= (params[i] - prior.mean[i]) * prior.deviation[i].powi(-2);
        }
        let anchored = Anchored::new(&at, anchor);
        let jacobian = anchored.jacobian();
        let bent = jacobian.transpose() * normal * jacobian;
        let right = jacobian.transpose() * right;
        let cost = now.squares / noise + prior.penalty(&at);
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
            let next = Drawn::new(patch, &cone, &weights, seam);
            if next.squares / noise + prior.penalty(&cone) < cost {
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
    let squares: f64 = now.residuals(patch).iter().zip(&base).map(|(r, b)| f64::from(b * r * r)).sum();
    let covariance = normal.cholesky().map_or_else(Places::zeros, |c| c.inverse());
    let (sin, cos) = at.angle.sin_cos();
    let (xx, xy, yy) = (covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]);
    Some(Fit {
        cone: at,
        unit: patch.unit,
        mix: std::array::from_fn(|i| now.mix[i]),
        residual: squares / patch.mass,
        empty: empty_residual(patch) / patch.mass,
        error_along: (xx * cos * cos + 2.0 * xy * sin * cos + yy * sin * sin).max(0.0).sqrt(),
        error_across: (xx * sin * sin - 2.0 * xy * sin * cos + yy * cos * cos).max(0.0).sqrt(),
    })
}

/// What does not look like a pipette (a cell beside it) counts less: Cauchy's weights about the typical residual.
fn reweigh(residuals: &[f32], base: &[f32], variance: f64, weights: &mut [f32]) {
    let mut sizes: Vec<f32> = residuals.iter().map(|r| r.abs()).collect();
    let middle = sizes.len() / 2;
    let typical = 1.48 * *sizes.select_nth_unstable_by(middle, f32::total_cmp).1;
    let limit = 6.25 * (typical * typical).max(variance as f32).max(f32::MIN_POSITIVE);
    for ((w, b), r) in weights.iter_mut().zip(base).zip(residuals) {
        *w = b / (1.0 + r * r / limit);
    }
}

/// The sum of squares that the light's level and slopes alone leave.
fn empty_residual(patch: &Patch) -> f64 {
    let mut normal = SMatrix::<f64, 3, 3>::zeros();
    let mut right = SVector::<f64, 3>::zeros();
    let mut total = 0.0;
    for s in &patch.samples {
        let v = SVector::<f64, 3>::new(1.0, f64::from(s.x / patch.radius), f64::from(s.y / patch.radius));
        let (value, weight) = (f64::from(s.value), f64::from(s.weight));
        normal += v * v.transpose() * weight;
        right += v * (weight * value);
        total += weight * value * value;
    }
    normal.cholesky().map_or(0.0, |c| (total - c.solve(&right).dot(&right)).max(0.0))
}
