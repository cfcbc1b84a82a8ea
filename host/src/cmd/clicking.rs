//! A person who says where a point is, in the terminal: the picture is written to a file, its pixel typed in.

use parfocal::frames::camera::Frame;
use parfocal::picture::Data;
use parfocal::procedure::{Found, FramePixel, Hint, NotFound, PointFinder, Witness};
use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};

/// Asks in the terminal.
pub struct TerminalFinder {
    picture: PathBuf,
}

impl TerminalFinder {
    /// Writes each question's picture to `picture`, a PNG.
    pub fn new(picture: PathBuf) -> Self {
        Self { picture }
    }
}

/// Writes a frame as an 8-bit PNG, stretched to its own range so that a person sees something.
fn write(path: &Path, frame: &Frame) -> image::ImageResult<()> {
    let (w, h) = (frame.picture.width as u32, frame.picture.height as u32);
    let values: Vec<u16> = match &frame.picture.data {
        Data::Grey8(d) => d.iter().map(|v| u16::from(*v)).collect(),
        Data::Grey16(d) => d.clone(),
    };
    let low = values.iter().copied().min().unwrap_or(0);
    let span = f32::from(values.iter().copied().max().unwrap_or(1) - low).max(1.0);
    let grey = |v: u16| (f32::from(v - low) / span * 255.0) as u8;
    let picture = image::GrayImage::from_raw(w, h, values.into_iter().map(grey).collect());
    picture.map_or(Ok(()), |picture| picture.save(path))
}

impl PointFinder for TerminalFinder {
    fn find(&mut self, frame: &Frame, hint: &Hint) -> Result<Found, NotFound> {
        let nobody = || NotFound::Nobody(hint.subject.clone());
        if let Err(error) = write(&self.picture, frame) {
            eprintln!("parfocal: {}: cannot be written: {error}", self.picture.display());
        }
        let (w, h) = (frame.picture.width as f64, frame.picture.height as f64);
        loop {
            let expected = hint.expected.map_or(String::new(), |at| format!(", near {:.0},{:.0}", at.x_px, at.y_px));
            eprint!(
                "Where is {}{expected}? The picture is {}. x,y in its pixels ('-' passes over, 'q' ends): ",
                hint.subject,
                self.picture.display()
            );
            std::io::stderr().flush().ok();
            let mut line = String::new();
            if std::io::stdin().lock().read_line(&mut line).is_ok_and(|n| n == 0) {
                return Err(nobody());
            }
            match line.trim() {
                "-" => return Err(NotFound::Passed(hint.subject.clone())),
                "q" => return Err(nobody()),
                answer => {
                    let numbers: Vec<f64> = answer.split([',', ' ']).filter_map(|n| n.trim().parse().ok()).collect();
                    if let [x_px, y_px] = numbers[..]
                        && (-0.5..=w - 0.5).contains(&x_px)
                        && (-0.5..=h - 0.5).contains(&y_px)
                    {
                        let at = FramePixel { x_px, y_px };
                        return Ok(Found { at, confidence: 1.0, angle_deg: None, by: Witness::Click });
                    }
                    eprintln!("Please answer with two numbers inside the picture of {w} x {h}, as in 320,240.");
                }
            }
        }
    }
}
