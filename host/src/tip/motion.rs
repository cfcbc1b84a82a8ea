//! Finds a pipette among cells and debris by its vibration.
//!
//! The pipette is moved sideways at a known frequency while the camera runs. Every pixel is correlated with that frequency over
//! the burst ([`swing`]): what stands still cancels, and how the pipette's light changes sideways remains, for all of it swings
//! in one phase. What the still detector's pipette would leave there if it swung ([`model`]) is looked for ([`start`]) and
//! fitted ([`fit`]): there is nothing else in that picture but noise, and how much of it is known from what swings in the other
//! phase.

mod fit;
mod kernel;
mod model;
mod start;
mod swing;

use super::pyramid::{Level, halve};
use super::{Expect, PIXEL_UM, Tip, inside};
use crate::picture::{Picture, PictureError, View};
use swing::Swing;
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
/// fills the scale. What stands still, drifts or swings at another frequency cancels.
///
/// # Errors
/// [`MotionError`]: too few frames, a frequency that the frames cannot show, or frames of different size.
pub fn vibration(frames: &[View<'_>], fps: f64, vibration_hz: f64) -> Result<Picture, MotionError> {
    let Swing { width, height, real, imaginary, .. } = Swing::of(frames, fps, vibration_hz)?;
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
    let (picture, noise) = Swing::of(frames, fps, vibration_hz)?.in_phase();
    let halvings = expect.halvings();
    let scale = (1 << halvings) as f64;
    let levels = levels(picture, halvings);
    let unit = PIXEL_UM / (expect.pixel_um * scale);
    let best = fit::best(&levels, noise / scale, unit, |angle| expect.allows(angle));
    let (width, height) = (levels[0].width as f64, levels[0].height as f64);
    let tip = best.filter(|b| expect.allows(b.cone.angle) && inside(width, height, b.cone.x, b.cone.y)).map(|b| Tip {
        x_px: (b.cone.x + 0.5) * scale - 0.5,
        y_px: (b.cone.y + 0.5) * scale - 0.5,
        angle_deg: (b.cone.angle.to_degrees() + 180.0).rem_euclid(360.0) - 180.0,
        confidence: b.confidence(),
        blur_px: b.cone.blur * scale,
    });
    Ok(tip.filter(|tip| tip.confidence >= expect.confidence))
}

/// Pixels of the coarsest resolution at most: a pipette is laid over all of them, at every one of them.
const COARSE_PIXELS: usize = 2000;

/// A picture at halved and halved again resolutions, after `halvings` that are not counted.
fn levels(picture: Level, halvings: usize) -> Vec<Level> {
    let halved = |l: &Level| halve(&l.values, l.width, l.width, l.height, l.step);
    let mut finest = picture;
    for _ in 0..halvings {
        finest = Level { step: 1, ..halved(&finest) };
    }
    let mut levels = vec![finest];
    while let Some(last) = levels.last().filter(|l| l.width * l.height > COARSE_PIXELS) {
        levels.push(halved(last));
    }
    levels
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

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
