//! How much of what lies about a fitted pipette it explains, at every distance alike.

#![allow(clippy::needless_range_loop, reason = "lanes of several arrays, side by side")]

use super::fit::Fit;
use super::model::Drawing;
use super::pyramid::Level;
use std::f64::consts::TAU;
use std::sync::LazyLock;

/// Radii (px) of the rings and the level each is sampled from.
pub const RINGS: [(f64, usize); 11] = [
    (10.0, 0),
    (15.0, 1),
    (21.0, 1),
    (30.0, 1),
    (43.0, 2),
    (61.0, 2),
    (87.0, 3),
    (124.0, 3),
    (175.0, 3),
    (250.0, 3),
    (350.0, 3),
];

/// Samples of a ring.
const DIRECTIONS: usize = 32;

/// Where they lie, along the pipette and across it, in radii.
static AROUND: LazyLock<[[f64; 2]; DIRECTIONS]> = LazyLock::new(|| {
    std::array::from_fn(|j| {
        let turn = TAU * (j as f64 + 0.5) / DIRECTIONS as f64;
        [turn.cos(), turn.sin()]
    })
});

/// How well a fit explains what lies near, at a middle distance and far: the share of each ring's variance, averaged over the
/// rings that the picture holds enough of on the shank's side. 1: all of it; 0 and less: it might as well not be there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Explained {
    pub near: f64,
    pub middle: f64,
    pub far: f64,
    /// Rings averaged.
    pub rings: f64,
}

/// Asks the rings about a fit; `noise` is a pixel's standard deviation.
pub fn explained(levels: &[Level], fit: &Fit, noise: f64) -> Explained {
    let shares: Vec<Option<f64>> = RINGS.iter().map(|ring| share(levels, fit, noise, *ring)).collect();
    let mean = |part: &[Option<f64>]| {
        let held: Vec<f64> = part.iter().flatten().copied().collect();
        held.iter().sum::<f64>() / (held.len().max(1) as f64)
    };
    Explained {
        near: mean(&shares[..5]),
        middle: mean(&shares[5..8]),
        far: mean(&shares[8..]),
        rings: shares.iter().flatten().count() as f64,
    }
}

fn share(levels: &[Level], fit: &Fit, noise: f64, (radius, level): (f64, usize)) -> Option<f64> {
    let level = levels.get(level)?;
    let cone = &fit.cone;
    let drawing = Drawing::new(cone, level.step as f64, [cone.x, cone.y], fit.unit);
    let (sin, cos) = cone.angle.sin_cos();
    let (mut x, mut y, mut value, mut held) =
        ([0.0; DIRECTIONS], [0.0; DIRECTIONS], [0.0; DIRECTIONS], [0.0; DIRECTIONS]);
    let mut behind = 0;
    for (j, [along, across]) in AROUND.iter().enumerate() {
        let (dx, dy) = (along * cos - across * sin, along * sin + across * cos);
        let Some(seen) = level.nearest(cone.x + radius * dx, cone.y + radius * dy) else { continue };
        behind += usize::from(*along < -0.5);
        (value[j], held[j]) = (seen.0 as f32, 1.0);
        (x[j], y[j]) = ((seen.1 - cone.x) as f32, (seen.2 - cone.y) as f32);
    }
    let n: f32 = held.iter().sum();
    if n < 8.0 || behind < 6 {
        return None;
    }
    let mix = fit.mix.map(|m| m as f32);
    let mut rest = [0.0_f32; DIRECTIONS];
    for j in 0..DIRECTIONS {
        let shapes = drawing.shapes::<true>(x[j], y[j]);
        rest[j] = value[j] - (mix[0] * shapes[0] + mix[1] * shapes[1] + mix[2] * shapes[2]);
    }
    let variance = |of: &[f32; DIRECTIONS]| {
        let mean = of.iter().zip(&held).map(|(v, held)| v * held).sum::<f32>() / n;
        f64::from(of.iter().zip(&held).map(|(v, held)| held * (v - mean).powi(2)).sum::<f32>() / n)
    };
    let (total, left) = (variance(&value), variance(&rest));
    let floor = (noise / level.step as f64).powi(2);
    Some(((total - left) / (total + floor)).max(-1.0))
}
