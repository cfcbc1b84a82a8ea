//! What a burst shows of one frequency.

use super::MotionError;
use crate::picture::{Pixels, View};
use crate::tip::pyramid::Level;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// How every pixel swings: its light is a slow drift, and `real`·cos + `imaginary`·sin of the vibration's phase.
pub struct Swing {
    pub width: usize,
    pub height: usize,
    pub real: Vec<f32>,
    pub imaginary: Vec<f32>,
    /// Standard deviation of a pixel's noise at least: whole grey values are known no better.
    rounding: f64,
}

impl Swing {
    /// By least squares over the burst, pixel by pixel.
    pub fn of(frames: &[View<'_>], fps: f64, vibration_hz: f64) -> Result<Self, MotionError> {
        if !(vibration_hz > 0.0 && vibration_hz < 0.5 * fps) {
            return Err(MotionError::Frequency { vibration_hz, fps });
        }
        let periods = frames.len() as f64 * vibration_hz / fps;
        if frames.len() < 8 || periods < 2.0 {
            return Err(MotionError::TooShort { frames: frames.len(), fps, vibration_hz, periods });
        }
        let (width, height) = (frames[0].width(), frames[0].height());
        if let Some(index) = frames.iter().position(|f| (f.width(), f.height()) != (width, height)) {
            let odd = &frames[index];
            return Err(MotionError::Shape {
                index,
                width: odd.width(),
                height: odd.height(),
                first_width: width,
                first_height: height,
            });
        }
        let (cosines, sines) = weights(frames.len(), vibration_hz / fps);
        let (mut real, mut imaginary) = (vec![0.0_f32; width * height], vec![0.0_f32; width * height]);
        for ((frame, c), s) in frames.iter().zip(&cosines).zip(&sines) {
            add(frame, *c as f32, *s as f32, &mut real, &mut imaginary);
        }
        let rounding = (2.0 / (12.0 * frames.len() as f64)).sqrt();
        Ok(Self { width, height, real, imaginary, rounding })
    }

    /// What swings with the pipette, and the standard deviation of a pixel's noise in it.
    pub fn in_phase(&self) -> (Level, f64) {
        // All of a pipette swings in one phase, or against it: the phase that holds most of the power, where neighbours are
        // taken together, so that it is not the noise's.
        let (mut cross, mut difference) = (0.0, 0.0);
        let (columns, rows) = (self.width / BLOCK, self.height / BLOCK);
        for j in 0..rows {
            for i in 0..columns {
                let sum = |values: &[f32]| -> f64 {
                    let row = |y: usize| &values[(j * BLOCK + y) * self.width + i * BLOCK..][..BLOCK];
                    (0..BLOCK).flat_map(row).map(|v| f64::from(*v)).sum()
                };
                let (a, b) = (sum(&self.real), sum(&self.imaginary));
                cross += 2.0 * a * b;
                difference += a * a - b * b;
            }
        }
        let (sin, cos) = (0.5 * cross.atan2(difference)).sin_cos();
        let (sin, cos) = (sin as f32, cos as f32);
        let both = || self.real.iter().zip(&self.imaginary);
        let values: Vec<f32> = both().map(|(a, b)| a * cos + b * sin).collect();
        // Across the phase there is nothing but noise.
        let mut rest: Vec<f32> = both().map(|(a, b)| (b * cos - a * sin).abs()).collect();
        let middle = rest.len() / 2;
        let noise = f64::from(*rest.select_nth_unstable_by(middle, f32::total_cmp).1) / 0.6745;
        (Level { width: self.width, height: self.height, step: 1, values }, noise.max(self.rounding))
    }
}

/// Side of the blocks that a phase is taken from, px.
const BLOCK: usize = 8;

/// Powers of time that a pixel may drift by.
const DRIFT: usize = 3;

/// What a pixel's values are multiplied with and summed to give the swing's two parts, at `frequency` (periods a frame): the
/// last two rows of the least-squares solution for drift, cosine and sine.
fn weights(n: usize, frequency: f64) -> (Vec<f64>, Vec<f64>) {
    let basis = DMatrix::from_fn(n, DRIFT + 2, |k, j| {
        let phase = TAU * frequency * k as f64;
        match j {
            DRIFT => phase.cos(),
            j if j > DRIFT => phase.sin(),
            j => (2.0 * (k as f64 + 0.5) / n as f64 - 1.0).powi(j as i32),
        }
    });
    let normal = basis.transpose() * &basis;
    let Some(cholesky) = normal.cholesky() else { return (vec![0.0; n], vec![0.0; n]) };
    let row = |j: usize| {
        let mut unit = DVector::zeros(DRIFT + 2);
        unit[j] = 1.0;
        (&basis * cholesky.solve(&unit)).iter().copied().collect()
    };
    (row(DRIFT), row(DRIFT + 1))
}

fn add(frame: &View<'_>, c: f32, s: f32, real: &mut [f32], imaginary: &mut [f32]) {
    let width = frame.width();
    for (y, (re, im)) in real.chunks_exact_mut(width).zip(imaginary.chunks_exact_mut(width)).enumerate() {
        let from = y * frame.stride();
        let mut each = |x: usize, value: f32| {
            re[x] += c * value;
            im[x] += s * value;
        };
        match frame.pixels() {
            Pixels::Grey8(p) => p[from..from + width].iter().enumerate().for_each(|(x, v)| each(x, f32::from(*v))),
            Pixels::Grey16(p) => p[from..from + width].iter().enumerate().for_each(|(x, v)| each(x, f32::from(*v))),
        }
    }
}
