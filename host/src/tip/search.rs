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

struct Ring<'a> {
    level: &'a Level,
    shift: u32,
    offsets: [(i32, i32); DIRECTIONS],
    floor: f32,
}

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
            Some(Ring { level, shift: level.step.trailing_zeros(), offsets, floor })
        })
        .collect();
    let Some(finest) = levels.first() else { return Vec::new() };
    let (width, height) = (finest.width * finest.step, finest.height * finest.step);
    let spacing = if width * height > 1_000_000 {
        8
    } else if width * height > 60_000 {
        4
    } else {
        2
    };
    // Tip direction is opposite to the shank's.
    let open: [bool; DIRECTIONS] =
        std::array::from_fn(|j| allowed(TAU * j as f64 / DIRECTIONS as f64 + std::f64::consts::PI));
    let mut found = Vec::new();
    for y in (spacing / 2..height).step_by(spacing) {
        for x in (spacing / 2..width).step_by(spacing) {
            if let Some((score, j)) = best_direction(&rings, x as i32, y as i32, &open)
                && score > 1.0
            {
                found.push((score, x, y, j));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<Candidate> = Vec::new();
    for (_, x, y, j) in found {
        let (x, y) = (x as f64, y as f64);
        let angle = TAU * j / DIRECTIONS as f64 + std::f64::consts::PI;
        let near = |c: &Candidate| (c.x - x).hypot(c.y - y) < 24.0 && (c.angle - angle).cos() > 0.5;
        if !kept.iter().any(near) {
            kept.push(Candidate { x, y, angle });
            if kept.len() == count {
                break;
            }
        }
    }
    kept
}

/// The clearest direction of the shank (in units of the ring's spacing, interpolated) and its score.
fn best_direction(rings: &[Ring<'_>], x: i32, y: i32, open: &[bool; DIRECTIONS]) -> Option<(f32, f64)> {
    let mut sums = [0.0_f32; DIRECTIONS];
    let mut squared = [0.0_f32; DIRECTIONS];
    let mut spreads = [0.0_f32; DIRECTIONS];
    let mut heard = [0_u32; DIRECTIONS];
    for ring in rings {
        let (w, h) = (ring.level.width as i32, ring.level.height as i32);
        let mut values = [0.0_f32; DIRECTIONS];
        let mut inside = [0.0_f32; DIRECTIONS];
        for (j, &(dx, dy)) in ring.offsets.iter().enumerate() {
            let (px, py) = ((x + dx) >> ring.shift, (y + dy) >> ring.shift);
            if px >= 0 && py >= 0 && px < w && py < h {
                values[j] = ring.level.values[(py * w + px) as usize];
                inside[j] = 1.0;
            }
        }
        let n: f32 = inside.iter().sum();
        if n < 10.0 {
            continue;
        }
        let sum: f32 = values.iter().sum();
        let squares: f32 = values.iter().map(|v| v * v).sum();
        for j in 0..DIRECTIONS {
            let (a, b) = ((j + DIRECTIONS - 1) % DIRECTIONS, (j + 1) % DIRECTIONS);
            let k = inside[a] + inside[j] + inside[b];
            if inside[j] == 0.0 {
                continue;
            }
            let lobe = values[a] + values[j] + values[b];
            let (rest, m) = (sum - lobe, n - k);
            let rest_squares = squares - values[a].powi(2) - values[j].powi(2) - values[b].powi(2);
            let mean = rest / m;
            let variance = (rest_squares / m - mean * mean).max(0.0) + ring.floor;
            let d = lobe / k - mean;
            sums[j] += d;
            squared[j] += d * d;
            spreads[j] += variance;
            heard[j] += 1;
        }
    }
    let votes: [f32; DIRECTIONS] = std::array::from_fn(|j| {
        let n = heard[j] as f32;
        if n < 3.0 {
            return 0.0;
        }
        let mean = sums[j] / n;
        let odd = (squared[j] / n - mean * mean).max(0.0);
        n.sqrt() * mean / (spreads[j] / n + odd).sqrt()
    });
    let mut best: Option<(f32, usize)> = None;
    for j in 0..DIRECTIONS {
        // A tip whose shank is out of the picture after the first ring cannot be told from dirt.
        if open[j] && heard[j] >= 3 && best.is_none_or(|(score, _)| votes[j].abs() > score) {
            best = Some((votes[j].abs(), j));
        }
    }
    let (score, j) = best?;
    let at = |i: usize| votes[i % DIRECTIONS].abs();
    let (a, b, c) = (at(j + DIRECTIONS - 1), score, at(j + 1));
    let bend = a - 2.0 * b + c;
    let shift = if bend < 0.0 { (0.5 * (a - c) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    Some((score, j as f64 + f64::from(shift)))
}
