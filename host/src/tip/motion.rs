//! Finds a pipette among cells and debris by its vibration.
//!
//! The pipette is moved sideways at a known frequency while the camera runs. Every pixel is correlated with that frequency over
//! the burst: what stands still cancels, and how the pipette's light changes sideways remains, for all of it swings in one
//! phase. Summed up along the direction of the motion that gives the pipette alone, as a still picture would show it.

use super::{Expect, Tip, detect_smooth};
use crate::picture::{Picture, PictureError, Pixels, View};
use std::f64::consts::TAU;
use thiserror::Error;

/// Why a burst cannot be used.
#[derive(Debug, Error, PartialEq)]
pub enum MotionError {
    /// Too few frames for two periods, or none.
    #[error(
        "{frames} frames at {fps} frames/s hold {periods:.1} periods of {vibration_hz} Hz: record at least two periods and 8 frames"
    )]
    TooShort {
        /// Frames there are.
        frames: usize,
        /// Frames a second.
        fps: f64,
        /// The vibration's frequency.
        vibration_hz: f64,
        /// Periods that the frames hold.
        periods: f64,
    },
    /// The camera cannot see the frequency.
    #[error("{vibration_hz} Hz cannot be seen at {fps} frames/s: it must lie above 0 and below {}", fps / 2.0)]
    Frequency {
        /// The vibration's frequency.
        vibration_hz: f64,
        /// Frames a second.
        fps: f64,
    },
    /// Frames differ in size.
    #[error(
        "frame {index} is {width}x{height}, the first is {first_width}x{first_height}: a burst's frames must be alike"
    )]
    Shape {
        /// Number of the frame, from 0.
        index: usize,
        /// Its columns.
        width: usize,
        /// Its rows.
        height: usize,
        /// The first frame's columns.
        first_width: usize,
        /// The first frame's rows.
        first_height: usize,
    },
    /// No picture can be made of it.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

/// What a burst shows of one frequency.
struct Swing {
    width: usize,
    height: usize,
    real: Vec<f32>,
    imaginary: Vec<f32>,
}

fn swing(frames: &[View<'_>], fps: f64, vibration_hz: f64) -> Result<Swing, MotionError> {
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
    Ok(Swing { width, height, real, imaginary })
}

/// How strongly each pixel swings at `vibration_hz` in frames taken `fps` a second, as a 16-bit picture whose brightest pixel
/// fills the scale. A Hann window over the burst keeps neighbouring frequencies and slow drift out.
///
/// # Errors
/// [`MotionError`]: too few frames, a frequency that the frames cannot show, or frames of different size.
pub fn vibration(frames: &[View<'_>], fps: f64, vibration_hz: f64) -> Result<Picture, MotionError> {
    let Swing { width, height, real, imaginary } = swing(frames, fps, vibration_hz)?;
    let swing: Vec<f32> = real.iter().zip(&imaginary).map(|(a, b)| a.hypot(*b)).collect();
    let most = swing.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
    let grey = swing.iter().map(|v| (v / most * f32::from(u16::MAX)) as u16).collect();
    Ok(Picture::grey16(width, height, grey)?)
}

/// The mean position of the tip of a vibrating pipette in a burst of frames.
///
/// # Errors
/// As [`vibration`].
pub fn detect_vibrating(
    frames: &[View<'_>],
    fps: f64,
    vibration_hz: f64,
    expect: &Expect,
) -> Result<Option<Tip>, MotionError> {
    Ok(detect_smooth(&alone(swing(frames, fps, vibration_hz)?)?.view(), expect))
}

/// Pixels that a swing is summed up over on either side of a place, until it fades out.
const REACH_PX: f64 = 160.0;

/// Half of the pixels along the pipette that are averaged first: streaks of noise are narrow, a pipette is long.
const LENGTH_PX: isize = 6;

/// The pipette as a still picture without anything else would show it.
fn alone(swing: Swing) -> Result<Picture, MotionError> {
    let Swing { width, height, real, imaginary } = swing;
    // All of a pipette swings in one phase, or against it: the phase that holds most of the power.
    let power = |f: fn(f32, f32) -> f32| real.iter().zip(&imaginary).map(|(a, b)| f64::from(f(*a, *b))).sum::<f64>();
    let phase = 0.5 * (2.0 * power(|a, b| a * b)).atan2(power(|a, b| a * a - b * b));
    let (sin, cos) = (phase.sin() as f32, phase.cos() as f32);
    let sideways: Vec<f32> = real.iter().zip(&imaginary).map(|(a, b)| a * cos + b * sin).collect();
    let across = direction(&sideways, width, height);
    let (dx, dy) = (across.cos(), across.sin());
    let sideways = along(&sideways, width, height, across + TAU / 4.0);
    let steps = REACH_PX as usize;
    let fade: Vec<f32> = (1..=steps).map(|k| (0.5 + 0.5 * (k as f64 / REACH_PX * TAU / 2.0).cos()) as f32).collect();
    let ways: Vec<(isize, isize)> =
        (1..=steps).map(|k| ((k as f64 * dx).round() as isize, (k as f64 * dy).round() as isize)).collect();
    let at = |x: isize, y: isize| {
        let held = x >= 0 && y >= 0 && (x as usize) < width && (y as usize) < height;
        if held { sideways[y as usize * width + x as usize] } else { 0.0 }
    };
    let mut light = Vec::with_capacity(width * height);
    for y in 0..height as isize {
        for x in 0..width as isize {
            // From both sides: what is uncertain on one is weighed by the other.
            let sum: f32 = ways.iter().zip(&fade).map(|((i, j), f)| f * (at(x - i, y - j) - at(x + i, y + j))).sum();
            light.push(sum);
        }
    }
    let most = light.iter().fold(f32::MIN_POSITIVE, |most, v| most.max(v.abs()));
    let grey = light.iter().map(|v| (32_768.0 + 32_000.0 * v / most) as u16).collect();
    Ok(Picture::grey16(width, height, grey)?)
}

/// Averages along a direction, weighted by a cosine's bell.
fn along(values: &[f32], width: usize, height: usize, direction: f64) -> Vec<f32> {
    let (dx, dy) = (direction.cos(), direction.sin());
    let bell = |k: isize| (0.5 + 0.5 * (k as f64 / (LENGTH_PX + 1) as f64 * TAU / 2.0).cos()) as f32;
    let total: f32 = (-LENGTH_PX..=LENGTH_PX).map(bell).sum();
    let ways: Vec<(isize, isize, f32)> = (-LENGTH_PX..=LENGTH_PX)
        .map(|k| ((k as f64 * dx).round() as isize, (k as f64 * dy).round() as isize, bell(k) / total))
        .collect();
    let mut smooth = Vec::with_capacity(values.len());
    for y in 0..height as isize {
        for x in 0..width as isize {
            let sum = ways.iter().map(|(i, j, weight)| {
                // What lies beyond the edge is as on it.
                let (u, v) = ((x + i).clamp(0, width as isize - 1), (y + j).clamp(0, height as isize - 1));
                weight * values[v as usize * width + u as usize]
            });
            smooth.push(sum.sum());
        }
    }
    smooth
}

/// The direction in which a swing changes most, rad: across the pipette. From the swing's own gradients (the structure
/// tensor), over blocks that are wide enough to be above the noise.
fn direction(sideways: &[f32], width: usize, height: usize) -> f64 {
    const BLOCK: usize = 6;
    let (w, h) = (width / BLOCK, height / BLOCK);
    let mut blocks = vec![0.0_f64; w * h];
    for y in 0..h * BLOCK {
        for x in 0..w * BLOCK {
            blocks[y / BLOCK * w + x / BLOCK] += f64::from(sideways[y * width + x]);
        }
    }
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let i = y * w + x;
            let (gx, gy) = (blocks[i + 1] - blocks[i - 1], blocks[i + w] - blocks[i - w]);
            xx += gx * gx;
            xy += gx * gy;
            yy += gy * gy;
        }
    }
    0.5 * (2.0 * xy).atan2(xx - yy)
}

/// A windowed cosine and sine of `frequency` (periods a frame), both blind to a steady value.
fn weights(n: usize, frequency: f64) -> (Vec<f64>, Vec<f64>) {
    let hann: Vec<f64> = (0..n).map(|k| 0.5 - 0.5 * (TAU * (k as f64 + 0.5) / n as f64).cos()).collect();
    let wave = |of: fn(f64) -> f64| {
        let mut w: Vec<f64> = hann.iter().enumerate().map(|(k, h)| h * of(TAU * frequency * k as f64)).collect();
        let steady = w.iter().sum::<f64>() / hann.iter().sum::<f64>();
        w.iter_mut().zip(&hann).for_each(|(w, h)| *w -= steady * h);
        w
    };
    (wave(f64::cos), wave(f64::sin))
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of four pixels: one steady, one swinging at 5 Hz, one at 9 Hz, one drifting.
    fn burst() -> Vec<Picture> {
        (0..60)
            .map(|k| {
                let t = f64::from(k) / 30.0;
                let swing = |hz: f64| 1000.0 * (TAU * hz * t + 0.7).sin();
                let values = [0.0, swing(5.0), swing(9.0), 300.0 * t];
                Picture::grey16(4, 1, values.iter().map(|v| (30000.0 + v) as u16).collect()).unwrap()
            })
            .collect()
    }

    #[test]
    fn only_what_swings_at_the_frequency_remains() {
        let burst = burst();
        let views: Vec<View<'_>> = burst.iter().map(Picture::view).collect();
        let swing = vibration(&views, 30.0, 5.0).unwrap();
        let at = |x| swing.view().get(x, 0).unwrap();
        assert_eq!(at(1), u16::MAX);
        assert!([0, 2, 3].iter().all(|x| at(*x) < 700), "{} {} {}", at(0), at(2), at(3));
    }

    #[test]
    fn impossible_bursts_are_refused() {
        let mut burst = burst();
        let refused = |burst: &[Picture], fps, hz| {
            let views: Vec<View<'_>> = burst.iter().map(Picture::view).collect();
            vibration(&views, fps, hz).unwrap_err()
        };
        assert!(matches!(refused(&burst, 30.0, 15.0), MotionError::Frequency { .. }));
        assert!(matches!(refused(&burst, 30.0, f64::NAN), MotionError::Frequency { .. }));
        assert!(matches!(refused(&burst[..7], 30.0, 5.0), MotionError::TooShort { .. }));
        assert!(matches!(refused(&[], 30.0, 5.0), MotionError::TooShort { .. }));
        assert!(matches!(refused(&burst, 30.0, 0.5), MotionError::TooShort { .. }));
        burst[3] = Picture::grey16(2, 2, vec![0; 4]).unwrap();
        assert!(matches!(refused(&burst, 30.0, 5.0), MotionError::Shape { index: 3, .. }));
    }
}
