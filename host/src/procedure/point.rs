//! Where a point is in a frame: what a person clicks on, or what a detector finds, behind one trait.

use crate::calibration::chain::{Pixel, Sensor};
use crate::frames::camera::Frame;
use crate::picture::Roi;
use crate::rig::{Camera, ManipulatorNumber};
use std::fmt;
use thiserror::Error;

/// A place in a frame as the camera delivers it, cropped and binned: (0, 0) is the centre of its top-left pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FramePixel {
    /// Columns from the left.
    pub x_px: f64,
    /// Rows from the top.
    pub y_px: f64,
}

impl FramePixel {
    /// Distance in the frame, px.
    pub fn distance_px(self, other: Self) -> f64 {
        (self.x_px - other.x_px).hypot(self.y_px - other.y_px)
    }
}

/// The part of the sensor that frames show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    sensor: Sensor,
    crop: Option<[u32; 4]>,
    binning: u32,
}

impl Window {
    /// What the rig's file says of its camera.
    pub fn of(camera: &Camera) -> Self {
        let sensor = Sensor { width_px: camera.width_px, height_px: camera.height_px };
        Self { sensor, crop: camera.crop_px, binning: camera.binning.max(1) }
    }

    /// Frames that show the whole sensor, pixel by pixel.
    pub fn whole(sensor: Sensor) -> Self {
        Self { sensor, crop: None, binning: 1 }
    }

    /// The whole sensor.
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Columns and rows of a frame.
    pub fn frame_size(&self) -> (usize, usize) {
        let [_, _, w, h] = self.shown();
        ((w / self.binning) as usize, (h / self.binning) as usize)
    }

    /// The sensor's pixel at a place of a frame.
    pub fn to_sensor(&self, at: FramePixel) -> Pixel {
        Sensor::from_frame(at.x_px, at.y_px, self.crop, self.binning)
    }

    /// The place of a frame that shows a pixel of the sensor.
    pub fn to_frame(&self, pixel: Pixel) -> FramePixel {
        let [left, top, ..] = self.shown();
        let bin = |v: f64, start: u32| (v - f64::from(start) + 0.5) / f64::from(self.binning) - 0.5;
        FramePixel { x_px: bin(pixel.x_px, left), y_px: bin(pixel.y_px, top) }
    }

    /// Whether frames show a pixel, at least `margin_px` of the sensor's pixels from their edge.
    pub fn shows(&self, pixel: Pixel, margin_px: f64) -> bool {
        let [left, top, w, h] = self.shown();
        let inside = |v: f64, start: u32, size: u32| {
            let low = f64::from(start) - 0.5;
            v >= low + margin_px && v <= low + f64::from(size) - margin_px
        };
        inside(pixel.x_px, left, w) && inside(pixel.y_px, top, h)
    }

    /// The pixel at a share of the shown part's width and height, 0 to 1 from edge to edge less `margin_px`.
    pub fn at_share(&self, x: f64, y: f64, margin_px: f64) -> Pixel {
        let [left, top, w, h] = self.shown();
        let at = |share: f64, start: u32, size: u32| {
            let margin = margin_px.min(f64::from(size) / 2.0 - 0.5).max(0.0);
            f64::from(start) - 0.5 + margin + share * (f64::from(size) - 2.0 * margin)
        };
        Pixel { x_px: at(x, left, w), y_px: at(y, top, h) }
    }

    /// The shorter side of what is shown, in the sensor's pixels.
    pub fn side_px(&self) -> f64 {
        let [_, _, w, h] = self.shown();
        f64::from(w.min(h))
    }

    /// A square region of frames around a place, moved inside them where it would leave them. `side` is in frame pixels.
    pub fn region(&self, around: Pixel, side: usize) -> Roi {
        let (w, h) = self.frame_size();
        let at = self.to_frame(around);
        let start = |v: f64, size: usize, side: usize| {
            let low = (v - side as f64 / 2.0 + 0.5).round().max(0.0) as usize;
            low.min(size - side)
        };
        let (width, height) = (side.clamp(1, w), side.clamp(1, h));
        Roi { x: start(at.x_px, w, width), y: start(at.y_px, h, height), width, height }
    }

    fn shown(&self) -> [u32; 4] {
        self.crop.unwrap_or([0, 0, self.sensor.width_px, self.sensor.height_px])
    }
}

/// What is looked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Subject {
    /// The tip of a manipulator's pipette.
    Tip(ManipulatorNumber),
    /// A point that stays where it is, by the name a person gave it.
    Point(String),
    /// A place on a pipette's shank, away from the tip.
    Shank(ManipulatorNumber),
}

impl fmt::Display for Subject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tip(n) => write!(f, "the tip of {n}"),
            Self::Point(name) => write!(f, "point '{name}'"),
            Self::Shank(n) => write!(f, "the shank of {n}"),
        }
    }
}

/// What is known before looking.
#[derive(Clone, Debug, PartialEq)]
pub struct Hint {
    /// What is looked for.
    pub subject: Subject,
    /// Where it should be, if that is known.
    pub expected: Option<FramePixel>,
    /// How far from there it may be, px of the frame; nothing farther off is taken.
    pub within_px: Option<f64>,
    /// The direction in which a tip should point in the frame, if that is known: degrees as in [`Found::angle_deg`].
    pub angle_deg: Option<f64>,
}

impl Hint {
    /// Looks for `subject` anywhere.
    pub fn anywhere(subject: Subject) -> Self {
        Self { subject, expected: None, within_px: None, angle_deg: None }
    }

    /// Whether a place is as expected.
    pub fn allows(&self, at: FramePixel) -> bool {
        match (self.expected, self.within_px) {
            (Some(expected), Some(within)) => expected.distance_px(at) <= within,
            _ => true,
        }
    }
}

/// Who said where a point is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Witness {
    /// A person who clicked on it.
    Click,
    /// A detector.
    Detector,
}

impl fmt::Display for Witness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Click => "click",
            Self::Detector => "detector",
        })
    }
}

/// A point that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Where in the frame.
    pub at: FramePixel,
    /// How sure it is, 0 to 1; a person is 1.
    pub confidence: f64,
    /// Direction in which a tip points, from x (right) towards y (down), degrees; if the finder knows.
    pub angle_deg: Option<f64>,
    /// Who says so.
    pub by: Witness,
}

/// Why no point was found.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum NotFound {
    /// The detector sees none.
    #[error("{0} is not seen in the picture")]
    Unseen(Subject),
    /// What was found is too far from where it should be.
    #[error("{subject} was found {off_px} px from where it should be, more than {within_px}")]
    Elsewhere {
        /// What was looked for.
        subject: Subject,
        /// How far off, px.
        off_px: u32,
        /// How far it may be, px.
        within_px: u32,
    },
    /// The person said that it is not there.
    #[error("{0} was not clicked: the person passed")]
    Passed(Subject),
    /// Nobody is there to answer any more.
    #[error("nobody answers where {0} is: the questions ended")]
    Nobody(Subject),
}

impl NotFound {
    /// Whether asking again elsewhere is pointless.
    pub fn is_final(&self) -> bool {
        matches!(self, Self::Nobody(_))
    }
}

/// Finds a point in frames.
pub trait PointFinder {
    /// Where in `frame` the point is.
    ///
    /// # Errors
    /// [`NotFound`]; a wrong place is worse than none.
    fn find(&mut self, frame: &Frame, hint: &Hint) -> Result<Found, NotFound>;
}

impl<F: PointFinder + ?Sized> PointFinder for &mut F {
    fn find(&mut self, frame: &Frame, hint: &Hint) -> Result<Found, NotFound> {
        (**self).find(frame, hint)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(crop: Option<[u32; 4]>, binning: u32) -> Window {
        Window { sensor: Sensor { width_px: 1920, height_px: 1200 }, crop, binning }
    }

    #[test]
    fn frame_and_sensor_agree_whatever_the_crop_and_binning() {
        for (crop, binning) in [(None, 1), (None, 2), (Some([100, 50, 800, 600]), 1), (Some([100, 50, 800, 600]), 4)] {
            let window = window(crop, binning);
            let at = FramePixel { x_px: 12.25, y_px: 7.5 };
            let back = window.to_frame(window.to_sensor(at));
            assert!(at.distance_px(back) < 1e-9, "{crop:?} {binning}");
            let (w, h) = window.frame_size();
            // The corners of the frame are the corners of what is shown.
            let corner = window.to_sensor(FramePixel { x_px: w as f64 - 0.5, y_px: h as f64 - 0.5 });
            assert!(window.shows(corner, 0.0) && !window.shows(corner, 0.1), "{corner:?}");
            let far = window.at_share(1.0, 1.0, 0.0);
            assert!((far.x_px - corner.x_px).abs() < 1e-9 && (far.y_px - corner.y_px).abs() < 1e-9);
        }
    }

    #[test]
    fn a_region_stays_in_the_frame() {
        let window = window(Some([100, 50, 800, 600]), 2);
        for (x, y) in [(100.0, 50.0), (899.0, 649.0), (500.0, 300.0)] {
            let roi = window.region(Pixel { x_px: x, y_px: y }, 48);
            assert!(roi.width == 48 && roi.x + 48 <= 400 && roi.y + 48 <= 300, "{roi}");
        }
        assert_eq!(
            window.region(Pixel { x_px: 500.5, y_px: 350.5 }, 1000),
            Roi { x: 0, y: 0, width: 400, height: 300 }
        );
    }
}
