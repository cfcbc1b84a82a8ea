//! Where in a swing's picture a pipette may end: typical ones, in all directions, laid over every place.
//!
//! Each is laid over the whole of the picture, as coarse as it can be, so that all places explain the same pixels: what is
//! explained is largest at the tip, and not anywhere along the shank (a matched filter, generalised likelihood ratio).

use super::kernel::Kernel;
use super::model::{Picture, Swinging};
use crate::tip::pyramid::Level;
use std::f64::consts::TAU;

/// Directions that are tried, and blurs of the tip.
const DIRECTIONS: usize = 36;
const BLURS: [f64; 2] = [-12.0, 8.0];

/// How far outside the picture a tip may lie, coarse pixels: a shank whose tip is not seen has to be told from one whose is.
const OUTSIDE: usize = 10;

/// Places closer to a better one than this, px, that point within this of it, rad, are the same.
const SAME_PX: f64 = 40.0;
const SAME_RAD: f64 = 0.5;

/// The `count` places that explain most of `level`, best first. `typical`: a pipette at the origin that points along x.
pub fn places(
    level: &Level,
    unit: f64,
    typical: Swinging,
    count: usize,
    allowed: impl Fn(f64) -> bool,
) -> Vec<Swinging> {
    let (w, h) = (level.width, level.height);
    let (columns, rows) = (w + 2 * OUTSIDE, h + 2 * OUTSIDE);
    let step = level.step as f64;
    let mut found: Vec<(f32, Swinging)> = Vec::new();
    for k in 0..DIRECTIONS {
        let angle = TAU * k as f64 / DIRECTIONS as f64;
        if !allowed(angle) {
            continue;
        }
        for blur in BLURS {
            let mut pipette = typical;
            pipette.cone.angle = angle;
            pipette.cone.blur = blur * unit;
            let shape = Shape::new(&pipette, step, unit, columns, rows);
            for j in 0..rows {
                for i in 0..columns {
                    let score = shape.explains(level, columns - i, rows - j);
                    let place = |i: usize| (i as f64 - OUTSIDE as f64 + 0.5) * step - 0.5;
                    let mut at = pipette;
                    (at.cone.x, at.cone.y) = (place(i), place(j));
                    keep(&mut found, count, score, at);
                }
            }
        }
    }
    found.into_iter().map(|f| f.1).collect()
}

/// Keeps the best of each place, best first.
fn keep(found: &mut Vec<(f32, Swinging)>, count: usize, score: f32, at: Swinging) {
    if score <= 0.0 || (found.len() == count && score <= found[count - 1].0) {
        return;
    }
    let same = |other: &Swinging| {
        (other.cone.x - at.cone.x).hypot(other.cone.y - at.cone.y) < SAME_PX
            && (other.cone.angle - at.cone.angle).cos() > SAME_RAD.cos()
    };
    if found.iter().any(|f| f.0 >= score && same(&f.1)) {
        return;
    }
    found.retain(|f| !same(&f.1));
    let rank = found.iter().position(|f| f.0 < score).unwrap_or(found.len());
    found.insert(rank, (score, at));
    found.truncate(count);
}

/// A pipette's swing about its tip, over twice the width and height of the places it is laid over.
struct Shape {
    width: usize,
    values: Vec<f32>,
}

impl Shape {
    fn new(pipette: &Swinging, step: f64, unit: f64, columns: usize, rows: usize) -> Self {
        let picture = Picture::new(pipette, Kernel::both()[0], step, [0.0, 0.0], unit);
        let width = 2 * columns;
        let place = |i: usize, middle: usize| ((i as f64 - middle as f64) * step) as f32;
        let values = (0..2 * rows)
            .flat_map(|j| (0..width).map(move |i| (i, j)))
            .map(|(i, j)| picture.shape(place(i, columns), place(j, rows)))
            .collect();
        Self { width, values }
    }

    /// What it explains of the picture's squares, where its pixel at `left`, `top` lies over the corner of the places.
    fn explains(&self, level: &Level, left: usize, top: usize) -> f32 {
        let (mut both, mut own) = (0.0, 0.0);
        for (j, row) in level.values.chunks_exact(level.width).enumerate() {
            let shape = &self.values[(top + OUTSIDE + j) * self.width + left + OUTSIDE..][..level.width];
            let (mut row_both, mut row_own) = ([0.0_f32; 8], [0.0_f32; 8]);
            for (value, shape) in row.chunks_exact(8).zip(shape.chunks_exact(8)) {
                for k in 0..8 {
                    row_both[k] += value[k] * shape[k];
                    row_own[k] += shape[k] * shape[k];
                }
            }
            let rest = level.width - level.width % 8;
            for (value, shape) in row[rest..].iter().zip(&shape[rest..]) {
                row_both[0] += value * shape;
                row_own[0] += shape * shape;
            }
            both += row_both.iter().sum::<f32>();
            own += row_own.iter().sum::<f32>();
        }
        if own > 0.0 { both * both / own } else { 0.0 }
    }
}
