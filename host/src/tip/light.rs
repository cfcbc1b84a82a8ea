//! The lamp's uneven light, and the noise, of a picture.

use super::pyramid::Level;
use nalgebra::{SMatrix, SVector};

const TERMS: usize = 6;

/// Level, slopes and curvatures of the light across the picture; places run from -1 to 1.
#[derive(Clone, Copy, Debug)]
pub struct Light {
    terms: SVector<f64, TERMS>,
}

fn basis(u: f64, v: f64) -> [f64; TERMS] {
    [1.0, u, v, u * u, u * v, v * v]
}

impl Light {
    /// Fits a picture's light; what deviates most (what lies in it) counts least.
    pub fn of(level: &Level) -> Self {
        // A small picture may be all pipette: curves would follow it.
        let curved = level.width.min(level.height) * level.step >= 300;
        let mut terms = SVector::<f64, TERMS>::zeros();
        let mut scale2 = f64::INFINITY;
        let places = |n: usize| (0..n).map(move |i| 2.0 * (i as f64 + 0.5) / n as f64 - 1.0);
        let columns: Vec<f64> = places(level.width).collect();
        // What the terms leave of each pixel.
        let mut left: Vec<f64> = level.values.iter().map(|value| f64::from(*value)).collect();
        let mut deviations = Vec::with_capacity(left.len());
        for _ in 0..5 {
            let mut normal = [[0.0; TERMS]; TERMS];
            let mut right = [0.0; TERMS];
            let rows = level.values.chunks_exact(level.width).zip(left.chunks_exact(level.width));
            for ((values, left), v) in rows.zip(places(level.height)) {
                for ((value, r), u) in values.iter().zip(left).zip(&columns) {
                    let b = if curved { basis(*u, v) } else { [1.0, 0.0, 0.0, 0.0, 0.0, 0.0] };
                    let w = 1.0 / (1.0 + r * r / scale2);
                    let seen = w * f64::from(*value);
                    for i in 0..TERMS {
                        right[i] += b[i] * seen;
                        for j in 0..=i {
                            normal[i][j] += b[i] * b[j] * w;
                        }
                    }
                }
            }
            let normal = SMatrix::<f64, TERMS, TERMS>::from_fn(|i, j| {
                normal[i.max(j)][i.min(j)] + if i == j { 1e-9 } else { 0.0 }
            });
            let Some(cholesky) = normal.cholesky() else { break };
            terms = cholesky.solve(&SVector::from(right));
            let rows = level.values.chunks_exact(level.width).zip(left.chunks_exact_mut(level.width));
            for ((values, left), v) in rows.zip(places(level.height)) {
                for ((value, r), u) in values.iter().zip(left).zip(&columns) {
                    *r = f64::from(*value) - terms.dot(&SVector::from(basis(*u, v)));
                }
            }
            deviations.clear();
            deviations.extend(left.iter().map(|r| r.abs()));
            let middle = deviations.len() / 2;
            let typical = *deviations.select_nth_unstable_by(middle, f64::total_cmp).1 * 1.48;
            scale2 = (4.0 * typical * typical).max(1e-6);
        }
        Self { terms }
    }

    /// Takes the light away from a level.
    pub fn flatten(&self, level: &mut Level) {
        let t: [f64; TERMS] = self.terms.into();
        let (w, h) = (level.width as f64, level.height as f64);
        for (j, row) in level.values.chunks_exact_mut(level.width).enumerate() {
            let v = 2.0 * (j as f64 + 0.5) / h - 1.0;
            let (level, slope, bend) = (t[0] + t[2] * v + t[5] * v * v, t[1] + t[4] * v, t[3]);
            let (level, slope, bend) = (level as f32, slope as f32, bend as f32);
            let (first, each) = ((1.0 / w - 1.0) as f32, (2.0 / w) as f32);
            for (i, value) in row.iter_mut().enumerate() {
                let u = first + each * i as i32 as f32;
                *value -= level + u * (slope + u * bend);
            }
        }
    }
}

/// A pixel's noise, as a standard deviation: from the differences that neighbours' slopes do not explain, seen at half the
/// resolution (Immerkær 1996, with a median instead of a mean), where noise is half of a pixel's.
pub fn noise(half: &Level) -> f64 {
    let w = half.width;
    if w < 3 || half.height < 3 {
        return 0.0;
    }
    let every = (half.height / 120).max(1);
    let skipped = (w / 320).max(1);
    let mut seen = Vec::new();
    for y in (1..half.height - 1).step_by(every) {
        let (a, b, c) =
            (&half.values[(y - 1) * w..y * w], &half.values[y * w..][..w], &half.values[(y + 1) * w..][..w]);
        seen.extend((1..w - 1).step_by(skipped).map(|x| {
            let corners = a[x - 1] + a[x + 1] + c[x - 1] + c[x + 1];
            let sides = a[x] + c[x] + b[x - 1] + b[x + 1];
            (corners - 2.0 * sides + 4.0 * b[x]).abs()
        }));
    }
    let middle = seen.len() / 2;
    let typical = f64::from(*seen.select_nth_unstable_by(middle, f32::total_cmp).1);
    // The mask's weights square to 36; a median deviation is 0.6745 of a standard deviation.
    2.0 * typical / (6.0 * 0.6745)
}
