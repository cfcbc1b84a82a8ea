//! Where in a picture a pipette may end.
//!
//! Seen from its tip a pipette fills one sector at every distance, and nothing fills the others: a sector in the picture, for
//! the farther its glass the wider its blur. So rings about each place, each sampled as coarsely as it is wide, are asked for
//! one direction in which all differ from their rests.

use super::pyramid::Level;
use std::f64::consts::TAU;

/// A place where a pipette may end.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    pub x: f64,
    pub y: f64,
    /// Direction in which the tip points, rad.
    pub angle: f64,
}

const DIRECTIONS: usize = 24;

/// Radii (px) of the rings, and the level that each is sampled from.
const RINGS: [(f64, usize); 5] = [(12.0, 1), (20.0, 1), (34.0, 2), (57.0, 3), (96.0, 3)];

/// Directions with their neighbours at both ends.
const AROUND: usize = DIRECTIONS + 2;

struct Ring<'a> {
    level: &'a Level,
    shift: u32,
    reach: i32,
    offsets: [(i32, i32); DIRECTIONS],
    floor: f32,
}

/// Pixels from one place asked about to the next; a blurred tip answers from several.
const SPACING: usize = 8;
/// The same in a picture with few pixels.
const FINE_SPACING: usize = 3;
const FEW_PIXELS: usize = 60_000;

/// The most promising places, best first, at most `count`; `noise` is a pixel's standard deviation. `allowed` says which
/// directions (of the tip) are asked for.
pub fn candidates(levels: &[Level], noise: f64, count: usize, allowed: impl Fn(f64) -> bool) -> Vec<Candidate> {
    let rings: Vec<Ring<'_>> = RINGS
        .iter()
        .filter_map(|&(radius, level)| {
            let level = levels.get(level)?;
            let offsets = std::array::from_fn(|j| {
                let a = TAU * j as f64 / DIRECTIONS as f64;
                ((radius * a.cos()).round() as i32, (radius * a.sin()).round() as i32)
            });
            let floor = (noise / level.step as f64).powi(2) as f32;
            Some(Ring { level, shift: level.step.trailing_zeros(), reach: radius as i32 + 1, offsets, floor })
        })
        .collect();
    let Some(finest) = levels.first() else { return Vec::new() };
    let (width, height) = (finest.width * finest.step, finest.height * finest.step);
    let spacing = if width * height > FEW_PIXELS { SPACING } else { FINE_SPACING };
    // Tip direction is opposite to the shank's.
    let open: [f32; DIRECTIONS] = std::array::from_fn(|j| {
        let angle = TAU * j as f64 / DIRECTIONS as f64 + std::f64::consts::PI;
        if allowed(angle) { 1.0 } else { 0.0 }
    });
    let mut found = Vec::new();
    for y in (spacing / 2..height).step_by(spacing) {
        for x in (spacing / 2..width).step_by(spacing) {
            let (score, j) = best_direction(&rings, x as i32, y as i32, &open);
            if score > 1.0 {
                found.push((score, x as i32, y as i32, j));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<Candidate> = Vec::new();
    for (score, x, y, j) in found {
        let angle_of = |j: f64| TAU * j / DIRECTIONS as f64 + std::f64::consts::PI;
        let near = |c: &Candidate| {
            (c.x - f64::from(x)).hypot(c.y - f64::from(y)) < 24.0 && (c.angle - angle_of(j)).cos() > 0.5
        };
        if kept.iter().any(near) {
            continue;
        }
        // Between the places asked about there may be a better one.
        let half = spacing as i32 / 2;
        let around = [(-half, 0), (half, 0), (0, -half), (0, half)];
        let refined = around.map(|(dx, dy)| (best_direction(&rings, x + dx, y + dy, &open), x + dx, y + dy));
        let (_, x, y, j) = refined
            .iter()
            .fold((score, x, y, j), |best, &((score, j), x, y)| if score > best.0 { (score, x, y, j) } else { best });
        kept.push(Candidate { x: f64::from(x), y: f64::from(y), angle: angle_of(j) });
        if kept.len() == count {
            break;
        }
    }
    kept
}

/// What the rings say of each direction, summed up.
#[derive(Default)]
struct Votes {
    sums: [f32; DIRECTIONS],
    squared: [f32; DIRECTIONS],
    spreads: [f32; DIRECTIONS],
    heard: [f32; DIRECTIONS],
}

/// The clearest direction of the shank (in units of the ring's spacing, interpolated) and its score.
fn best_direction(rings: &[Ring<'_>], x: i32, y: i32, open: &[f32; DIRECTIONS]) -> (f32, f64) {
    let mut votes = Votes::default();
    for ring in rings {
        hear(ring, x, y, &mut votes);
    }
    let mut scores = [0.0_f32; DIRECTIONS];
    for j in 0..DIRECTIONS {
        // A tip whose shank is out of the picture after the first ring cannot be told from dirt.
        let n = votes.heard[j].max(1.0);
        let enough = if votes.heard[j] >= 3.0 { open[j] } else { 0.0 };
        let mean = votes.sums[j] / n;
        let odd = (votes.squared[j] / n - mean * mean).max(0.0);
        scores[j] = enough * n.sqrt() * mean.abs() / (votes.spreads[j] / n + odd).max(f32::MIN_POSITIVE).sqrt();
    }
    let mut best = 0;
    for j in 1..DIRECTIONS {
        if scores[j] > scores[best] {
            best = j;
        }
    }
    let (a, b, c) = (scores[(best + DIRECTIONS - 1) % DIRECTIONS], scores[best], scores[(best + 1) % DIRECTIONS]);
    let bend = a - 2.0 * b + c;
    let shift = if bend < 0.0 { (0.5 * (a - c) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    (b, best as f64 + f64::from(shift))
}

/// Asks one ring about a place.
#[inline]
fn hear(ring: &Ring<'_>, x: i32, y: i32, votes: &mut Votes) {
    let (w, h) = (ring.level.width as i32, ring.level.height as i32);
    // With the last direction before the first, and the first after the last.
    let (mut values, mut inside) = ([0.0_f32; AROUND], [1.0_f32; AROUND]);
    let whole =
        x >= ring.reach && y >= ring.reach && (x + ring.reach) >> ring.shift < w && (y + ring.reach) >> ring.shift < h;
    let all = &ring.level.values[..];
    let mut n = DIRECTIONS as f32;
    if whole {
        for (value, &(dx, dy)) in values[1..=DIRECTIONS].iter_mut().zip(&ring.offsets) {
            let (px, py) = ((x + dx) >> ring.shift, (y + dy) >> ring.shift);
            *value = all.get((py * w + px) as usize).copied().unwrap_or(0.0);
        }
    } else {
        for (j, &(dx, dy)) in ring.offsets.iter().enumerate() {
            let (px, py) = ((x + dx) >> ring.shift, (y + dy) >> ring.shift);
            let held = px >= 0 && py >= 0 && px < w && py < h;
            values[j + 1] = if held { all[(py * w + px) as usize] } else { 0.0 };
            inside[j + 1] = f32::from(u8::from(held));
        }
        n = inside[1..=DIRECTIONS].iter().sum();
        if n < 10.0 {
            return;
        }
        (inside[0], inside[AROUND - 1]) = (inside[DIRECTIONS], inside[1]);
    }
    (values[0], values[AROUND - 1]) = (values[DIRECTIONS], values[1]);
    let sum: f32 = values[1..=DIRECTIONS].iter().sum();
    let squares: f32 = values[1..=DIRECTIONS].iter().map(|v| v * v).sum();
    for j in 0..DIRECTIONS {
        let (a, b, c) = (values[j], values[j + 1], values[j + 2]);
        let k = inside[j] + inside[j + 1] + inside[j + 2];
        let lobe = a + b + c;
        let fewer = 1.0 / (n - k);
        let mean = (sum - lobe) * fewer;
        let variance = ((squares - a * a - b * b - c * c) * fewer - mean * mean).max(0.0) + ring.floor;
        let d = lobe / k.max(1.0) - mean;
        let held = inside[j + 1];
        votes.sums[j] += held * d;
        votes.squared[j] += held * d * d;
        votes.spreads[j] += held * variance;
        votes.heard[j] += held;
    }
}
