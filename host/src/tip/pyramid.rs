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

    /// The picture at half the resolution of nominal pixels, each `side` of the picture's wide. What is not a whole pixel of it at
    /// the right and the bottom is left away.
    fn of(view: &View<'_>, side: f64) -> Self {
        match view.pixels() {
            Pixels::Grey8(p) if side == 1.0 => halve(p, view.stride(), view.width(), view.height(), 1),
            Pixels::Grey16(p) if side == 1.0 => halve(p, view.stride(), view.width(), view.height(), 1),
            Pixels::Grey8(p) => averages(p, view, 2.0 * side),
            Pixels::Grey16(p) => averages(p, view, 2.0 * side),
        }
    }
}

/// The mean of the picture over squares of `side` pixels, of parts of pixels too.
fn averages<T: Copy + Into<f32>>(values: &[T], view: &View<'_>, side: f64) -> Level {
    let (width, height) = ((view.width() as f64 / side) as usize, (view.height() as f64 / side) as usize);
    let columns: Vec<Vec<(usize, f32)>> = (0..width).map(|i| shares(i, side, view.width())).collect();
    let mut out = Vec::with_capacity(width * height);
    let mut row = vec![0.0_f32; view.width()];
    for j in 0..height {
        row.fill(0.0);
        for (y, share) in shares(j, side, view.height()) {
            for (sum, value) in row.iter_mut().zip(&values[y * view.stride()..]) {
                *sum += share * (*value).into();
            }
        }
        out.extend(columns.iter().map(|shares| shares.iter().map(|(x, share)| share * row[*x]).sum::<f32>()));
    }
    Level { width, height, step: 2, values: out }
}

/// Which of `n` pixels the stretch numbered `i` of length `side` covers, and the share of the stretch that each is.
fn shares(i: usize, side: f64, n: usize) -> Vec<(usize, f32)> {
    let (from, to) = (i as f64 * side, (i + 1) as f64 * side);
    (from as usize..n.min(to.ceil() as usize))
        .map(|k| (k, ((to.min(k as f64 + 1.0) - from.max(k as f64)) / side) as f32))
        .collect()
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

/// Half, quarter, eighth and sixteenth of the picture, as far as they have pixels, counted in nominal pixels that are `side` of
/// the picture's wide.
pub fn levels(view: &View<'_>, side: f64) -> Vec<Level> {
    let mut levels = vec![Level::of(view, side)];
    while levels.len() < 4 {
        let last = &levels[levels.len() - 1];
        if last.width < 4 || last.height < 4 {
            break;
        }
        levels.push(halve(&last.values, last.width, last.width, last.height, last.step));
    }
    levels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Picture;

    #[test]
    fn averages_of_whole_pixels_are_those_of_halving() {
        let grey = (0..24 * 16).map(|i| (i * 37 % 251) as u16).collect();
        let picture = Picture::grey16(24, 16, grey).unwrap();
        let halved = Level::of(&picture.view(), 1.0);
        let Pixels::Grey16(values) = picture.view().pixels() else { panic!() };
        let averaged = averages(values, &picture.view(), 2.0);
        assert_eq!((halved.width, halved.height), (averaged.width, averaged.height));
        assert!(halved.values.iter().zip(&averaged.values).all(|(a, b)| (a - b).abs() < 1e-3));
    }

    #[test]
    fn a_stretch_is_shared_out_whole() {
        for side in [0.7, 1.5, 2.0, 3.3] {
            for i in 0..5 {
                let sum: f32 = shares(i, side, 100).iter().map(|s| s.1).sum();
                assert!((sum - 1.0).abs() < 1e-5, "{side} {i}: {sum}");
            }
        }
    }
}
