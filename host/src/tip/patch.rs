//! The pixels about a place, laid out for registers.

#![allow(clippy::needless_range_loop, reason = "lanes of several arrays, side by side")]

use super::pyramid::Level;
use nalgebra::{SMatrix, SVector};

/// Pixels that are worked on at once.
pub const LANES: usize = 8;

/// A number of each of some pixels.
pub type Lanes = [f32; LANES];

/// Works with the widest registers that the processor has, which the program as a whole is not built for. `work`, and all in it
/// that is to profit, has to be `#[inline(always)]`. What comes out is the same to the last bit: a lane does what it would alone.
#[inline(always)]
pub fn widest<R>(work: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(work)
}

/// Pixels: their places from the patch's middle (px), their values and weights. The last block is filled up with weight 0.
#[derive(Clone, Copy, Debug, Default)]
pub struct Block {
    pub x: Lanes,
    pub y: Lanes,
    pub value: Lanes,
    pub weight: Lanes,
}

/// The pixels of a disc, with their weights.
#[derive(Debug)]
pub struct Patch {
    pub x: f64,
    pub y: f64,
    pub step: f64,
    /// How many times finer than the model's optics a pixel is.
    pub unit: f64,
    pub radius: f32,
    pub blocks: Vec<Block>,
    /// Pixels there are.
    pub count: usize,
    /// Sum of the weights.
    pub mass: f64,
    /// The weighted sum of squares that the light's level and slopes alone leave.
    pub empty: f64,
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
        let mut blocks = Vec::with_capacity(columns.len() * columns.len() / LANES + 1);
        let (mut block, mut held) = (Block::default(), 0);
        let (mut mass, mut count) = (0.0, 0);
        for j in range(y, level.height) {
            let dy = level.picture_px(j) - y;
            for i in columns.clone() {
                let dx = level.picture_px(i) - x;
                let share = (dx * dx + dy * dy) / (radius * radius);
                if share < 1.0 {
                    let weight = (1.0 - share).powi(2);
                    mass += weight;
                    count += 1;
                    block.x[held] = dx as f32;
                    block.y[held] = dy as f32;
                    block.value[held] = level.values[j * level.width + i];
                    block.weight[held] = weight as f32;
                    held += 1;
                    if held == LANES {
                        blocks.push(std::mem::take(&mut block));
                        held = 0;
                    }
                }
            }
        }
        if held > 0 {
            blocks.push(block);
        }
        let mut patch = Self { x, y, step, unit, radius: radius as f32, blocks, count, mass, empty: 0.0 };
        patch.empty = patch.empty_squares();
        patch
    }

    /// Every pixel's weight.
    pub fn weights(&self) -> Vec<Lanes> {
        self.blocks.iter().map(|b| b.weight).collect()
    }

    fn empty_squares(&self) -> f64 {
        let mut normal = SMatrix::<f64, 3, 3>::zeros();
        let mut right = SVector::<f64, 3>::zeros();
        let mut total = 0.0;
        for block in &self.blocks {
            for l in 0..LANES {
                let v = SVector::from([1.0, f64::from(block.x[l] / self.radius), f64::from(block.y[l] / self.radius)]);
                let (value, weight) = (f64::from(block.value[l]), f64::from(block.weight[l]));
                normal += v * v.transpose() * weight;
                right += v * (weight * value);
                total += weight * value * value;
            }
        }
        normal.cholesky().map_or(0.0, |c| (total - c.solve(&right).dot(&right)).max(0.0))
    }
}
