//! Finds a pipette among cells and debris by its vibration.
//!
//! The pipette is moved sideways at a known frequency while the camera runs. Every pixel is correlated with that frequency over
//! the burst: what stands still cancels, and the pipette's outline remains.

use super::{Expect, Tip, detect};
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

/// How strongly each pixel swings at `vibration_hz` in frames taken `fps` a second, as a 16-bit picture whose brightest pixel
/// fills the scale. A Hann window over the burst keeps neighbouring frequencies and slow drift out.
///
/// # Errors
/// [`MotionError`]: too few frames, a frequency that the frames cannot show, or frames of different size.
pub fn vibration(frames: &[View<'_>], fps: f64, vibration_hz: f64) -> Result<Picture, MotionError> {
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
    Ok(detect(&vibration(frames, fps, vibration_hz)?.view(), expect))
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
