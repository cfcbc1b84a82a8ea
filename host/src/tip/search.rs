//! Where in a picture a pipette may end.
//!
//! Seen from its tip a pipette fills one sector at every distance, and nothing fills the others: a sector in the picture, for
//! the farther its glass the wider its blur. So rings about each place, each sampled as coarsely as it is wide, are asked for
//! one direction in which all differ from their rests. Places are asked about by the [`LANES`] at once.

#![allow(clippy::needless_range_loop, reason = "lanes of several arrays, side by side")]

use super::patch::{LANES, Lanes, widest};
use super::pyramid::Level;
use std::f64::consts::{PI, TAU};

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

/// Directions that a ring must hold.
const LEAST_HELD: f32 = 10.0;

/// Pixels from one place to the next at the first asking; a blurred tip answers from several.
const SPACING: usize = 16;
/// The same in a picture with few pixels. Powers of two, as levels' steps are.
const FINE_SPACING: usize = 8;
const FEW_PIXELS: usize = 60_000;

/// The best of the places, about each of which four are asked a second time: a share of all, and at least so many.
const AGAIN: usize = 10;
const AGAIN_AT_LEAST: usize = 400;

/// A level's values, laid out so that those which neighbouring places ask for lie side by side: one table for each place of a
/// pixel between two of them.
struct Lattice {
    tables: Vec<Vec<f32>>,
    /// 1 where a table's column lies in the picture.
    held: Vec<Vec<f32>>,
    columns: usize,
    rows: i32,
    /// Columns before the picture's first.
    before: i32,
    step: i32,
}

struct Ring<'a> {
    level: &'a Level,
    lattice: &'a Lattice,
    reach: i32,
    reads: [Read; DIRECTIONS],
    floor: f32,
}

/// Where a direction's values lie, from a place's own.
#[derive(Clone, Copy)]
struct Read {
    dx: i32,
    dy: i32,
    table: usize,
    column: i32,
}

/// What a place answers: how clearly a pipette ends there, and where its shank lies, in units of the ring's spacing.
#[derive(Clone, Copy, Debug)]
struct Answer {
    score: f32,
    x: i32,
    y: i32,
    direction: f64,
}

/// The most promising places, best first, at most `count`; `noise` is a pixel's standard deviation. `allowed` says which
/// directions (of the tip) are asked for.
pub fn candidates(levels: &[Level], noise: f64, count: usize, allowed: impl Fn(f64) -> bool) -> Vec<Candidate> {
    let Some(finest) = levels.first() else { return Vec::new() };
    let (width, height) = (finest.width * finest.step, finest.height * finest.step);
    let spacing = if width * height > FEW_PIXELS { SPACING } else { FINE_SPACING };
    let columns = (width + spacing - 1 - spacing / 2) / spacing;
    // Of the levels that a ring is sampled from.
    let asked = |k: usize| RINGS.iter().any(|ring| ring.1 == k);
    let lattices: Vec<Option<Lattice>> =
        levels.iter().enumerate().map(|(k, level)| asked(k).then(|| Lattice::new(level, spacing, columns))).collect();
    let rings: Vec<Ring<'_>> = RINGS
        .iter()
        .filter_map(|&(radius, level)| {
            Some(Ring::new(levels.get(level)?, lattices.get(level)?.as_ref()?, radius, noise, spacing as i32))
        })
        .collect();
    // Tip direction is opposite to the shank's.
    let angle_of = |direction: f64| TAU * direction / DIRECTIONS as f64 + PI;
    let open: [f32; DIRECTIONS] = std::array::from_fn(|j| if allowed(angle_of(j as f64)) { 1.0 } else { 0.0 });
    let mut answers = Vec::new();
    for y in (spacing / 2..height).step_by(spacing) {
        for first in (0..columns).step_by(LANES) {
            let asked = widest(
                #[inline(always)]
                || ask(&rings, first as i32, y as i32, spacing as i32, width as i32, &open),
            );
            answers.extend(asked.into_iter().take(columns - first).filter(|a| a.score > 1.0));
        }
    }
    let surest = |a: &Answer, b: &Answer| b.score.total_cmp(&a.score);
    let again = (answers.len() / AGAIN).max(AGAIN_AT_LEAST);
    if answers.len() > again {
        answers.select_nth_unstable_by(again, surest);
        answers.truncate(again);
    }
    let quarter = spacing as i32 / 4;
    let mut answers: Vec<Answer> = answers
        .chunks(2)
        .flat_map(|pair| {
            let about = |l: usize| pair[(l / 4).min(pair.len() - 1)];
            let x = std::array::from_fn(|l| about(l).x + if l % 2 == 0 { -quarter } else { quarter });
            let y = std::array::from_fn(|l| about(l).y + if l % 4 < 2 { -quarter } else { quarter });
            widest(
                #[inline(always)]
                || ask_again(&rings, x, y, &open),
            )
            .into_iter()
            .take(4 * pair.len())
        })
        .filter(|a| a.score > 1.0)
        .collect();
    answers.sort_by(surest);
    let mut kept: Vec<Candidate> = Vec::new();
    for answer in answers {
        let (x, y, angle) = (f64::from(answer.x), f64::from(answer.y), angle_of(answer.direction));
        let near = |c: &Candidate| (c.x - x).powi(2) + (c.y - y).powi(2) < 576.0 && (c.angle - angle).cos() > 0.5;
        if kept.iter().any(near) {
            continue;
        }
        kept.push(Candidate { x, y, angle });
        if kept.len() == count {
            break;
        }
    }
    kept
}

/// What the rings say of each direction, summed up, at [`LANES`] places.
#[derive(Default)]
struct Votes {
    sums: [Lanes; DIRECTIONS],
    squared: [Lanes; DIRECTIONS],
    spreads: [Lanes; DIRECTIONS],
    heard: [Lanes; DIRECTIONS],
}

/// Asks the rings about the places of row `y` from the `first` on; each answers with its clearest direction.
#[inline(always)]
fn ask(rings: &[Ring<'_>], first: i32, y: i32, spacing: i32, width: i32, open: &[f32; DIRECTIONS]) -> [Answer; LANES] {
    let x: [i32; LANES] = std::array::from_fn(|l| spacing / 2 + spacing * (first + l as i32));
    let mut votes = Votes::default();
    for ring in rings {
        let (mut values, mut inside) = ([[0.0; LANES]; AROUND], [[1.0; LANES]; AROUND]);
        let (bottom, step) = (ring.lattice.rows * ring.lattice.step, ring.lattice.step);
        let whole = x[0] >= ring.reach
            && x[LANES - 1] + ring.reach < width - step
            && y >= ring.reach
            && y + ring.reach < bottom;
        if whole {
            ring.read::<true>(first, y, &mut values, &mut inside);
            votes.hear::<true>(&values, &inside, ring.floor);
        } else {
            ring.read::<false>(first, y, &mut values, &mut inside);
            votes.hear::<false>(&values, &inside, ring.floor);
        }
    }
    votes.answers(x, [y; LANES], open)
}

/// Asks the rings about single places.
#[inline(always)]
fn ask_again(rings: &[Ring<'_>], x: [i32; LANES], y: [i32; LANES], open: &[f32; DIRECTIONS]) -> [Answer; LANES] {
    let mut votes = Votes::default();
    for ring in rings {
        let (mut values, mut inside) = ([[0.0; LANES]; AROUND], [[1.0; LANES]; AROUND]);
        ring.read_each(&x, &y, &mut values, &mut inside);
        votes.hear::<false>(&values, &inside, ring.floor);
    }
    votes.answers(x, y, open)
}

impl Lattice {
    fn new(level: &Level, spacing: usize, columns: usize) -> Self {
        let (step, width) = (level.step, level.width as i32);
        let reach = RINGS.iter().fold(0.0_f64, |most, ring| most.max(ring.0)) as usize;
        let before = (reach / spacing + 2) as i32;
        let all = columns + 2 * before as usize + LANES;
        let (split, same) = ((spacing / step).max(1) as i32, (step / spacing).max(1).trailing_zeros());
        let (mut tables, mut held) = (Vec::new(), Vec::new());
        for k in 0..split {
            let of = |i: usize| ((i as i32 - before) >> same) * split + k;
            let inside = |i: usize| (0..width).contains(&of(i));
            held.push((0..all).map(|i| f32::from(u8::from(inside(i)))).collect());
            let (low, high) = ((0..all).position(inside).unwrap_or(0), (0..all).rposition(inside).map_or(0, |i| i + 1));
            let mut table = vec![0.0; all * level.height];
            for (to, from) in table.chunks_exact_mut(all).zip(level.values.chunks_exact(level.width)) {
                for (i, value) in to.iter_mut().enumerate().take(high).skip(low) {
                    *value = from[of(i) as usize];
                }
            }
            tables.push(table);
        }
        Self { tables, held, columns: all, rows: level.height as i32, before, step: step as i32 }
    }
}

impl<'a> Ring<'a> {
    fn new(level: &'a Level, lattice: &'a Lattice, radius: f64, noise: f64, spacing: i32) -> Self {
        let step = lattice.step;
        let reads = std::array::from_fn(|j| {
            let a = TAU * j as f64 / DIRECTIONS as f64;
            let (dx, dy) = ((radius * a.cos()).round() as i32, (radius * a.sin()).round() as i32);
            let split = (spacing / step).max(1);
            let from = (spacing / 2 + dx).div_euclid(step.min(spacing));
            Read { dx, dy, table: from.rem_euclid(split) as usize, column: from.div_euclid(split) + lattice.before }
        });
        Self { level, lattice, reach: radius as i32 + step, reads, floor: (noise / f64::from(step)).powi(2) as f32 }
    }

    /// The values on the ring about each place, the last direction before the first and the first after the last, and which of
    /// them the picture holds.
    #[inline(always)]
    fn read<const WHOLE: bool>(&self, first: i32, y: i32, values: &mut [Lanes; AROUND], inside: &mut [Lanes; AROUND]) {
        let shift = self.lattice.step.trailing_zeros();
        for (j, read) in self.reads.iter().enumerate() {
            let row = (y + read.dy) >> shift;
            let column = (first + read.column) as usize;
            let held = (0..self.lattice.rows).contains(&row);
            if WHOLE || held {
                let at = row as usize * self.lattice.columns + column;
                if let Some(from) = self.lattice.tables[read.table].get(at..at + LANES) {
                    values[j + 1].copy_from_slice(from);
                }
            }
            if !WHOLE {
                match self.lattice.held[read.table].get(column..column + LANES) {
                    Some(from) if held => inside[j + 1].copy_from_slice(from),
                    _ => inside[j + 1] = [0.0; LANES],
                }
            }
        }
        (values[0], values[AROUND - 1]) = (values[DIRECTIONS], values[1]);
        (inside[0], inside[AROUND - 1]) = (inside[DIRECTIONS], inside[1]);
    }

    /// As [`Ring::read`], about places anywhere.
    #[inline(always)]
    fn read_each(
        &self,
        x: &[i32; LANES],
        y: &[i32; LANES],
        values: &mut [Lanes; AROUND],
        inside: &mut [Lanes; AROUND],
    ) {
        let (w, h, shift) = (self.level.width as i32, self.level.height as i32, self.level.step.trailing_zeros());
        for (j, read) in self.reads.iter().enumerate() {
            for l in 0..LANES {
                let (px, py) = ((x[l] + read.dx) >> shift, (y[l] + read.dy) >> shift);
                let held = (0..w).contains(&px) && (0..h).contains(&py);
                let value = if held { self.level.values.get((py * w + px) as usize) } else { None };
                values[j + 1][l] = value.copied().unwrap_or(0.0);
                inside[j + 1][l] = f32::from(u8::from(held));
            }
        }
        (values[0], values[AROUND - 1]) = (values[DIRECTIONS], values[1]);
        (inside[0], inside[AROUND - 1]) = (inside[DIRECTIONS], inside[1]);
    }
}

impl Votes {
    /// Takes in one ring's values; `WHOLE`: the picture holds all of them.
    #[inline(always)]
    fn hear<const WHOLE: bool>(&mut self, values: &[Lanes; AROUND], inside: &[Lanes; AROUND], floor: f32) {
        let (mut n, mut sum, mut squares) = ([0.0_f32; LANES], [0.0_f32; LANES], [0.0_f32; LANES]);
        for j in 1..=DIRECTIONS {
            for l in 0..LANES {
                n[l] += inside[j][l];
                sum[l] += values[j][l];
                squares[l] += values[j][l] * values[j][l];
            }
        }
        let heard: Lanes = n.map(|n| if n < LEAST_HELD { 0.0 } else { 1.0 });
        for j in 0..DIRECTIONS {
            for l in 0..LANES {
                let (a, b, c) = (values[j][l], values[j + 1][l], values[j + 2][l]);
                let (held, per_lobe, fewer) = if WHOLE {
                    (1.0, 1.0 / 3.0, 1.0 / (DIRECTIONS as f32 - 3.0))
                } else {
                    let k = inside[j][l] + inside[j + 1][l] + inside[j + 2][l];
                    (heard[l] * inside[j + 1][l], 1.0 / k.max(1.0), 1.0 / (n[l] - k).max(1.0))
                };
                let lobe = a + b + c;
                let mean = (sum[l] - lobe) * fewer;
                let variance = ((squares[l] - a * a - b * b - c * c) * fewer - mean * mean).max(0.0) + floor;
                let d = lobe * per_lobe - mean;
                self.sums[j][l] += held * d;
                self.squared[j][l] += held * d * d;
                self.spreads[j][l] += held * variance;
                self.heard[j][l] += held;
            }
        }
    }

    /// Each place's clearest direction.
    #[inline(always)]
    fn answers(&self, x: [i32; LANES], y: [i32; LANES], open: &[f32; DIRECTIONS]) -> [Answer; LANES] {
        let mut scores = [[0.0_f32; LANES]; DIRECTIONS];
        for j in 0..DIRECTIONS {
            for l in 0..LANES {
                // A tip whose shank is out of the picture after the first ring cannot be told from dirt.
                let enough = if self.heard[j][l] >= 3.0 { open[j] } else { 0.0 };
                let n = self.heard[j][l].max(1.0);
                let mean = self.sums[j][l] / n;
                let odd = (self.squared[j][l] / n - mean * mean).max(0.0);
                scores[j][l] = enough * n * mean * mean / (self.spreads[j][l] / n + odd).max(f32::MIN_POSITIVE);
            }
        }
        let (mut most, mut best) = ([-1.0_f32; LANES], [0_i32; LANES]);
        for (j, score) in scores.iter().enumerate() {
            for l in 0..LANES {
                let better = score[l] > most[l];
                most[l] = if better { score[l] } else { most[l] };
                best[l] = if better { j as i32 } else { best[l] };
            }
        }
        std::array::from_fn(|l| {
            let best = best[l] as usize;
            let score = |j: usize| scores[j % DIRECTIONS][l].sqrt();
            let (a, b, c) = (score(best + DIRECTIONS - 1), score(best), score(best + 1));
            let bend = a - 2.0 * b + c;
            let shift = if bend < 0.0 { (0.5 * (a - c) / bend).clamp(-0.5, 0.5) } else { 0.0 };
            Answer { score: b, x: x[l], y: y[l], direction: best as f64 + f64::from(shift) }
        })
    }
}
