//! A cone drawn on the pixels of a patch, its shapes mixed for the least squares (variable projection).

#![allow(clippy::needless_range_loop, reason = "lanes of several arrays, side by side")]

use super::model::{Cone, Drawing, GLASS, PLACES, SEAM};
use super::patch::{Block, LANES, Lanes, Patch, widest};
use nalgebra::{SMatrix, SVector};

/// Shapes that mix linearly: the pipette's, and the light's level and two slopes.
pub const SHAPES: usize = GLASS + 3;

type Shapes = SMatrix<f64, SHAPES, SHAPES>;
type Mix = SVector<f64, SHAPES>;
pub type Places = SMatrix<f64, PLACES, PLACES>;

/// Whether bent light joins the mix. The glass then comes with a seam as it mostly has, and what that differs by is kept small:
/// left free it takes the glass's part, kept too small it moves the tip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seam {
    Without,
    With,
}

/// All shapes at all pixels of a patch, for one cone.
pub struct Drawn {
    rows: Vec<[Lanes; GLASS]>,
    pub mix: Mix,
    /// What the mix leaves of each pixel's value.
    pub residuals: Vec<Lanes>,
    /// Weighted sum of the residuals' squares.
    pub squares: f64,
    /// The same with what an unlikely mix costs.
    pub cost: f64,
    /// The shapes' products, weighted, and the inverse that solved for the mix.
    normal: Shapes,
    inverse: Shapes,
    /// The shapes' products with the values, and the values' squares, weighted.
    right: Mix,
    total: f64,
    seam: Seam,
}

/// The least squares' normal equations for a cone's numbers, the mix following along (Kaufman 1975).
pub struct Equations {
    pub normal: Places,
    pub right: SVector<f64, PLACES>,
}

impl Drawn {
    /// `stiffness`: what the square of the seam's difference costs.
    pub fn new(patch: &Patch, cone: &Cone, weights: &[Lanes], seam: Seam, stiffness: f64) -> Self {
        let drawing = Drawing::new(cone, patch.step, [patch.x, patch.y], patch.unit);
        let rows = widest(
            #[inline(always)]
            || match seam {
                Seam::Without => rows::<false>(&drawing, &patch.blocks),
                Seam::With => rows::<true>(&drawing, &patch.blocks),
            },
        );
        let mut drawn = Self {
            rows,
            mix: Mix::zeros(),
            residuals: Vec::new(),
            squares: 0.0,
            cost: 0.0,
            normal: Shapes::zeros(),
            inverse: Shapes::zeros(),
            right: Mix::zeros(),
            total: 0.0,
            seam,
        };
        drawn.solve(patch, weights, stiffness);
        drawn
    }

    /// Mixes the shapes for the least weighted squares.
    pub fn solve(&mut self, patch: &Patch, weights: &[Lanes], stiffness: f64) {
        widest(
            #[inline(always)]
            || self.multiply(patch, weights),
        );
        let mut matrix = self.normal;
        // Shapes that look alike when blurred share the light evenly.
        let even = 1e-4 * matrix[(GLASS, GLASS)].max(1e-12);
        let ridge = [0.1 * even, 30.0 * even, stiffness.max(1e-3 * even)];
        for (i, ridge) in ridge.into_iter().enumerate() {
            matrix[(i, i)] += ridge;
        }
        self.inverse = matrix.cholesky().map_or_else(Shapes::zeros, |c| c.inverse());
        self.mix = self.inverse * self.right;
        widest(
            #[inline(always)]
            || self.subtract(patch, weights),
        );
        self.cost = self.squares + ridge.iter().enumerate().map(|(i, ridge)| ridge * self.mix[i].powi(2)).sum::<f64>();
    }

    /// The shapes' products with each other and with the values.
    #[inline(always)]
    fn multiply(&mut self, patch: &Patch, weights: &[Lanes]) {
        let per_radius = 1.0 / patch.radius;
        let mut sums = [[[0.0_f32; LANES]; SHAPES]; SHAPES];
        let mut right = [[0.0_f32; LANES]; SHAPES];
        let mut all = [0.0_f32; LANES];
        for ((row, block), w) in self.rows.iter().zip(&patch.blocks).zip(weights) {
            let v = shapes(row, block, per_radius);
            for l in 0..LANES {
                all[l] += w[l] * block.value[l] * block.value[l];
            }
            for i in 0..SHAPES {
                let wi: Lanes = std::array::from_fn(|l| w[l] * v[i][l]);
                add(&mut right[i], &wi, &block.value);
                for j in 0..=i {
                    add(&mut sums[i][j], &wi, &v[j]);
                }
            }
        }
        self.normal = Shapes::from_fn(|i, j| total(&sums[i.max(j)][i.min(j)]));
        self.right = Mix::from_fn(|i, _| total(&right[i]));
        self.total = total(&all);
    }

    /// What the mix leaves.
    #[inline(always)]
    fn subtract(&mut self, patch: &Patch, weights: &[Lanes]) {
        let per_radius = 1.0 / patch.radius;
        let mix: [f32; SHAPES] = std::array::from_fn(|i| self.mix[i] as f32);
        let mut squares = [0.0_f32; LANES];
        self.residuals.clear();
        for ((row, block), w) in self.rows.iter().zip(&patch.blocks).zip(weights) {
            let v = shapes(row, block, per_radius);
            let mut left = block.value;
            for (shape, m) in v.iter().zip(&mix) {
                for l in 0..LANES {
                    left[l] -= m * shape[l];
                }
            }
            for l in 0..LANES {
                squares[l] += w[l] * left[l] * left[l];
            }
            self.residuals.push(left);
        }
        self.squares = total(&squares);
    }

    /// The weighted squares that the light's level and slopes alone would leave.
    pub fn empty_squares(&self) -> f64 {
        let normal = self.normal.fixed_view::<3, 3>(GLASS, GLASS).into_owned();
        let right = self.right.fixed_rows::<3>(GLASS).into_owned();
        normal.cholesky().map_or(0.0, |c| (self.total - c.solve(&right).dot(&right)).max(0.0))
    }

    /// Standard error of the glass's share of the mix, in standard deviations of a pixel's noise.
    pub fn glass_error(&self) -> f64 {
        self.inverse[(0, 0)].max(0.0).sqrt()
    }

    /// How much of each of the pipette's shapes there is.
    pub fn shares(&self) -> [f64; GLASS] {
        let with = if self.seam == Seam::With { SEAM * self.mix[0] } else { 0.0 };
        [self.mix[0], self.mix[1], self.mix[2] + with]
    }

    /// How the squares change with the cone's numbers.
    pub fn equations(&self, patch: &Patch, cone: &Cone, weights: &[Lanes]) -> Equations {
        let drawing = Drawing::new(cone, patch.step, [patch.x, patch.y], patch.unit);
        widest(
            #[inline(always)]
            || match self.seam {
                Seam::Without => self.sums::<false>(patch, &drawing, weights),
                Seam::With => self.sums::<true>(patch, &drawing, weights),
            },
        )
    }

    #[inline(always)]
    fn sums<const SEAM_TOO: bool>(&self, patch: &Patch, drawing: &Drawing, weights: &[Lanes]) -> Equations {
        let per_radius = 1.0 / patch.radius;
        let mix = self.shares().map(|m| m as f32);
        let mut squares = [[[0.0_f32; LANES]; PLACES]; PLACES];
        let mut shared = [[[0.0_f32; LANES]; PLACES]; SHAPES];
        let mut pull = [[0.0_f32; LANES]; PLACES];
        let mut left = [[0.0_f32; LANES]; SHAPES];
        for (((row, block), w), residual) in self.rows.iter().zip(&patch.blocks).zip(weights).zip(&self.residuals) {
            let mut slopes = [[0.0_f32; LANES]; PLACES];
            for l in 0..LANES {
                let each = drawing.slopes::<SEAM_TOO>(block.x[l], block.y[l], &mix);
                for k in 0..PLACES {
                    slopes[k][l] = each[k];
                }
            }
            let v = shapes(row, block, per_radius);
            for k in 0..PLACES {
                let ws: Lanes = std::array::from_fn(|l| w[l] * slopes[k][l]);
                add(&mut pull[k], &ws, residual);
                for j in 0..=k {
                    add(&mut squares[k][j], &ws, &slopes[j]);
                }
                for i in 0..SHAPES {
                    add(&mut shared[i][k], &ws, &v[i]);
                }
            }
            let wr: Lanes = std::array::from_fn(|l| w[l] * residual[l]);
            for i in 0..SHAPES {
                add(&mut left[i], &wr, &v[i]);
            }
        }
        // A change of a number, less what the mix makes good of it.
        let shared = SMatrix::<f64, SHAPES, PLACES>::from_fn(|i, k| total(&shared[i][k]));
        let along = self.inverse * shared;
        let crossed = shared.transpose() * along;
        let normal = Places::from_fn(|i, j| total(&squares[i.max(j)][i.min(j)])) - crossed - crossed.transpose()
            + along.transpose() * self.normal * along;
        let right = SVector::<f64, PLACES>::from_fn(|k, _| total(&pull[k]))
            - along.transpose() * Mix::from_fn(|i, _| total(&left[i]));
        Equations { normal, right }
    }
}

#[inline(always)]
fn rows<const SEAM_TOO: bool>(drawing: &Drawing, blocks: &[Block]) -> Vec<[Lanes; GLASS]> {
    let mut rows = Vec::with_capacity(blocks.len());
    for block in blocks {
        let mut row = [[0.0; LANES]; GLASS];
        for l in 0..LANES {
            let shapes = drawing.shapes::<SEAM_TOO>(block.x[l], block.y[l]);
            for i in 0..GLASS {
                row[i][l] = shapes[i];
            }
            row[0][l] += if SEAM_TOO { SEAM as f32 * shapes[2] } else { 0.0 };
        }
        rows.push(row);
    }
    rows
}

/// The pipette's shapes and the light's.
#[inline(always)]
fn shapes(row: &[Lanes; GLASS], block: &Block, per_radius: f32) -> [Lanes; SHAPES] {
    let across = |at: &Lanes| std::array::from_fn(|l| at[l] * per_radius);
    [row[0], row[1], row[2], [1.0; LANES], across(&block.x), across(&block.y)]
}

#[inline(always)]
fn add(sum: &mut Lanes, a: &Lanes, b: &Lanes) {
    for l in 0..LANES {
        sum[l] += a[l] * b[l];
    }
}

fn total(lanes: &Lanes) -> f64 {
    lanes.iter().map(|v| f64::from(*v)).sum()
}
