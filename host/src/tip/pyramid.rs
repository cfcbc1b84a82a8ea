//! A picture at halved and halved again resolutions.

use crate::picture::{Pixels, View};

/// One resolution of the picture. A pixel is the mean of `step` x `step` of the picture's.
#[derive(Debug)]
pub struct Level {
    pub width: usize,
    pub height: usize,
    /// Pixels of the picture along one side of this level's pixel: 1, 2, 4, ….
    pub step: usize,
    pub values: Vec<f32>,
}

impl Level {
    /// Where the middle of this level's pixel `i` lies in the picture, px.
    pub fn picture_px(&self, i: usize) -> f64 {
        (i as f64 + 0.5) * self.step as f64 - 0.5
    }

    /// The value at a place in the picture, between the pixels about it; `None` outside their middles.
    pub fn between(&self, x: f64, y: f64) -> Option<f64> {
        let place = |v: f64, n: usize| {
            let u = (v + 0.5) / self.step as f64 - 0.5;
            (u >= 0.0 && u <= n as f64 - 1.0).then(|| {
                let i = (u as usize).min(n.saturating_sub(2));
                (i, u - i as f64)
            })
        };
        let ((i, u), (j, v)) = (place(x, self.width)?, place(y, self.height)?);
        let at =
            |i: usize, j: usize| f64::from(self.values[j.min(self.height - 1) * self.width + i.min(self.width - 1)]);
        let row = |j: usize| at(i, j) + u * (at(i + 1, j) - at(i, j));
        Some(row(j) + v * (row(j + 1) - row(j)))
    }

    /// The value of the pixel that holds a place in the picture, and that pixel's middle; `None` outside.
    pub fn nearest(&self, x: f64, y: f64) -> Option<(f64, f64, f64)> {
        let index = |v: f64, n: usize| {
            let i = ((v + 0.5) / self.step as f64).floor();
            (i >= 0.0 && i < n as f64).then_some(i as usize)
        };
        let (i, j) = (index(x, self.width)?, index(y, self.height)?);
        Some((f64::from(self.values[j * self.width + i]), self.picture_px(i), self.picture_px(j)))
    }

    /// The picture at half the resolution. Half pixels at the right and the bottom are left away.
    fn of(view: &View<'_>) -> Self {
        match view.pixels() {
            Pixels::Grey8(p) => halve(p, view.stride(), view.width(), view.height(), 1),
            Pixels::Grey16(p) => halve(p, view.stride(), view.width(), view.height(), 1),
        }
    }
}

pub fn halve<T: Copy + Into<f32>>(values: &[T], stride: usize, width: usize, height: usize, step: usize) -> Level {
    let (w, h) = (width / 2, height / 2);
    let mut out = Vec::with_capacity(w * h);
    let mut sums = vec![0.0_f32; 2 * w];
    for y in 0..h {
        let top = &values[2 * y * stride..][..2 * w];
        let bottom = &values[(2 * y + 1) * stride..][..2 * w];
        for ((sum, a), b) in sums.iter_mut().zip(top).zip(bottom) {
            *sum = (*a).into() + (*b).into();
        }
        out.extend(sums.chunks_exact(2).map(|pair| 0.25 * (pair[0] + pair[1])));
    }
    Level { width: w, height: h, step: 2 * step, values: out }
}

/// Half, quarter, eighth and sixteenth of the picture, as far as they have pixels. With `halvings` of the picture halved as many
/// times first, whose pixels they then count in.
pub fn levels(view: &View<'_>, halvings: usize) -> Vec<Level> {
    let mut levels = vec![Level::of(view)];
    while levels.len() < 4 + halvings {
        let last = &levels[levels.len() - 1];
        if last.width < 4 || last.height < 4 {
            break;
        }
        levels.push(halve(&last.values, last.width, last.width, last.height, last.step));
    }
    levels.drain(..halvings.min(levels.len() - 1));
    for level in &mut levels {
        level.step = (level.step >> halvings).max(1);
    }
    levels
}
