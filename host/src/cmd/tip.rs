//! `parfocal tip`: finds pipette tips in pictures, and a new pipette's tip at the rig.

mod overlay;
mod recalibrate;

use super::Output;
use super::connection::Connection;
use anyhow::{Context, bail};
use clap::{Args, Subcommand};
use parfocal::frames::image_file;
use parfocal::picture::{Picture, View};
use parfocal::tip::{Expect, Tip, detect, motion};
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Find the tips of micropipettes
#[derive(Debug, Args)]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Find the tip in pictures (PNG, TIFF, JPEG), or of a vibrating pipette in a burst of frames
    Detect(Detect),
    /// After a change of pipette: one focus, one detection, the new tip in force
    Recalibrate(recalibrate::Recalibrate),
}

#[derive(Debug, Args)]
struct Detect {
    /// Pictures
    #[arg(required_unless_present = "burst", conflicts_with = "burst")]
    images: Vec<PathBuf>,
    /// A folder of frames, in name order, of a pipette that vibrates sideways
    #[arg(long, value_name = "DIR", requires = "fps", requires = "vibration_hz")]
    burst: Option<PathBuf>,
    /// Frames a second of the burst
    #[arg(long)]
    fps: Option<f64>,
    /// Frequency at which the pipette vibrates
    #[arg(long)]
    vibration_hz: Option<f64>,
    /// Direction in which the tip points, degrees from x (right) towards y (down); other pipettes are passed over
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true)]
    expect_angle: Option<f64>,
    /// How far from --expect-angle it may point, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = Expect::default().tolerance_deg)]
    tolerance: f64,
    /// Report tips that are at least this sure, 0 to 1
    #[arg(long, value_name = "0..1", default_value_t = Expect::default().confidence)]
    confidence: f64,
    /// Size of a pixel at the sample, µm: says how wide a tip and its blur are in the picture
    #[arg(long, value_name = "UM", default_value_t = Expect::default().pixel_um, value_parser = super::calibrate::positive)]
    pixel_um: f64,
    /// Write the picture with the tip marked as a PNG (one picture only)
    #[arg(long, value_name = "FILE")]
    overlay: Option<PathBuf>,
}

#[derive(Serialize)]
struct Report {
    images: Vec<Found>,
}

/// What was found in one picture or burst.
#[derive(Serialize)]
struct Found {
    file: PathBuf,
    found: bool,
    x_px: Option<f64>,
    y_px: Option<f64>,
    angle_deg: Option<f64>,
    confidence: Option<f64>,
}

impl Found {
    fn new(file: &Path, tip: Option<Tip>) -> Self {
        Self {
            file: file.into(),
            found: tip.is_some(),
            x_px: tip.map(|t| t.x_px),
            y_px: tip.map(|t| t.y_px),
            angle_deg: tip.map(|t| t.angle_deg),
            confidence: tip.map(|t| t.confidence),
        }
    }
}

impl Arguments {
    /// # Errors
    /// A picture that cannot be read, a burst that cannot be used, an overlay that cannot be written.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        match self.action {
            Action::Detect(detect) => detect.run(out),
            Action::Recalibrate(recalibrate) => recalibrate.run(connection, out),
        }
    }
}

impl Detect {
    fn run(self, out: Output) -> anyhow::Result<()> {
        for (name, value) in [("--expect-angle", self.expect_angle), ("--tolerance", Some(self.tolerance))] {
            if value.is_some_and(|v| !v.is_finite()) {
                bail!("{name}: is not a number of degrees");
            }
        }
        if self.overlay.is_some() && self.images.len() > 1 {
            bail!("--overlay: shows one picture, {} are given: give one, or leave --overlay away", self.images.len());
        }
        let expect = Expect {
            angle_deg: self.expect_angle,
            tolerance_deg: self.tolerance,
            confidence: self.confidence,
            pixel_um: self.pixel_um,
        };
        let mut images = Vec::new();
        if let (Some(folder), Some(fps), Some(hz)) = (&self.burst, self.fps, self.vibration_hz) {
            let frames = frames_of(folder)?;
            let views: Vec<View<'_>> = frames.iter().map(Picture::view).collect();
            let tip =
                motion::detect_vibrating(&views, fps, hz, &expect).with_context(|| folder.display().to_string())?;
            self.draw(&frames[0], tip)?;
            images.push(Found::new(folder, tip));
        }
        for file in &self.images {
            let (picture, note) = image_file::read(file)?;
            if let Some(note) = note {
                eprintln!("{}: {note}", file.display());
            }
            let tip = detect(&picture.view(), &expect);
            self.draw(&picture, tip)?;
            images.push(Found::new(file, tip));
        }
        let mut text = String::new();
        for image in &images {
            match image {
                Found { x_px: Some(x), y_px: Some(y), angle_deg: Some(angle), confidence: Some(sure), .. } => writeln!(
                    text,
                    "{}: tip at {x:.2}, {y:.2} px, pointing to {angle:.1}°, confidence {sure:.2}",
                    image.file.display()
                )?,
                _ => writeln!(text, "{}: no tip", image.file.display())?,
            }
        }
        out.result(&text, &Report { images })
    }

    fn draw(&self, picture: &Picture, tip: Option<Tip>) -> anyhow::Result<()> {
        let Some(file) = &self.overlay else { return Ok(()) };
        overlay::draw(picture, tip).save(file).with_context(|| format!("{}: cannot be written", file.display()))
    }
}

/// The pictures of a folder in name order.
fn frames_of(folder: &Path) -> anyhow::Result<Vec<Picture>> {
    let context = || folder.display().to_string();
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .with_context(context)?
        .map(|entry| entry.map(|e| e.path()))
        .collect::<Result<_, _>>()
        .with_context(context)?;
    let picture = |file: &PathBuf| {
        let kind = file.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        ["png", "tif", "tiff", "jpg", "jpeg"].contains(&kind.as_str())
    };
    files.retain(picture);
    files.sort();
    if files.is_empty() {
        bail!("{}: holds no PNG, TIFF or JPEG files: give the folder of the burst's frames", folder.display());
    }
    files.iter().map(|file| Ok(image_file::read(file)?.0)).collect()
}
