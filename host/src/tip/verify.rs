//! How much of what lies about a fitted pipette it explains, at every distance alike.

use super::fit::Fit;
use super::model::Drawing;
use super::pyramid::Level;
use std::f64::consts::TAU;

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
    let mut pairs = Vec::with_capacity(DIRECTIONS);
    let mut behind = 0;
    for j in 0..DIRECTIONS {
        let turn = TAU * (j as f64 + 0.5) / DIRECTIONS as f64;
        let a = cone.angle + turn;
        let Some((value, x, y)) = level.nearest(cone.x + radius * a.cos(), cone.y + radius * a.sin()) else { continue };
        behind += usize::from(turn.cos() < -0.5);
        let shapes = drawing.shapes::<true>((x - cone.x) as f32, (y - cone.y) as f32);
        let drawn: f64 = fit.mix.iter().zip(shapes).map(|(m, s)| m * f64::from(s)).sum();
        pairs.push((value, drawn));
    }
    if pairs.len() < 8 || behind < 6 {
        return None;
    }
    let n = pairs.len() as f64;
    let mean = |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>() / n;
    let (value, rest) = (mean(&|p| p.0), mean(&|p| p.0 - p.1));
    let total = mean(&|p| (p.0 - value).powi(2));
    let left = mean(&|p| (p.0 - p.1 - rest).powi(2));
    let floor = (noise / level.step as f64).powi(2);
    Some(((total - left) / (total + floor)).max(-1.0))
}
