//! Recorded frames in the place of a camera, at their own pace, over and over: a y4m file or a folder of pictures.

use super::camera::{Camera, CameraError, Frame};
use super::image_file;
use super::y4m::Stream;
use crate::link::transport::real_now;
use crate::picture::Picture;
use parfocal_protocol::units::HostTime;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Pace of recordings that do not say theirs, frames a second.
const RATE: f64 = 25.0;
/// Pace of a folder's pictures.
const FOLDER_RATE: f64 = 10.0;

/// Where the next picture comes from.
enum Reel {
    Y4m { path: PathBuf, stream: Stream<BufReader<File>> },
    Folder { files: Vec<PathBuf>, next: usize },
}

/// A recording that plays.
pub struct Recording {
    name: String,
    reel: Reel,
    period: Duration,
    number: u64,
    due: HostTime,
    size: Option<(usize, usize)>,
}

impl Recording {
    /// A y4m file, at the rate its header says.
    ///
    /// # Errors
    /// [`CameraError::Ended`] when it cannot be read.
    pub fn y4m(path: &Path) -> Result<Self, CameraError> {
        let stream = open(path)?;
        let rate = stream.header().rate;
        Ok(Self::new(path, Reel::Y4m { path: path.into(), stream }, if rate > 0.0 { rate } else { RATE }))
    }

    /// A folder's PNG, TIFF and JPEG pictures in the order of their names, ten a second.
    ///
    /// # Errors
    /// [`CameraError::Ended`] when there are none.
    pub fn folder(path: &Path) -> Result<Self, CameraError> {
        let failed = |reason: String| CameraError::Ended { camera: path.display().to_string(), reason };
        let picture = |path: &Path| {
            let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
            ["png", "tif", "tiff", "jpg", "jpeg"].contains(&extension.as_str())
        };
        let entries = std::fs::read_dir(path).map_err(|e| failed(format!("the folder cannot be read: {e}")))?;
        let mut files: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).filter(|p| picture(p)).collect();
        files.sort();
        if files.is_empty() {
            return Err(failed("the folder holds no PNG, TIFF or JPEG pictures".into()));
        }
        Ok(Self::new(path, Reel::Folder { files, next: 0 }, FOLDER_RATE))
    }

    fn new(path: &Path, reel: Reel, rate: f64) -> Self {
        let period = Duration::from_secs_f64(1.0 / rate.clamp(0.01, 1000.0));
        Self { name: path.display().to_string(), reel, period, number: 0, due: real_now(), size: None }
    }

    fn picture(&mut self) -> Result<Picture, String> {
        match &mut self.reel {
            Reel::Y4m { path, stream } => {
                if let Some(picture) = stream.frame().map_err(|e| e.to_string())? {
                    return Ok(picture);
                }
                *stream = open(path).map_err(|e| e.to_string())?;
                stream.frame().map_err(|e| e.to_string())?.ok_or_else(|| "the file holds no frames".into())
            }
            Reel::Folder { files, next } => {
                let file = &files[*next % files.len()];
                *next = (*next + 1) % files.len();
                image_file::read(file).map(|(picture, _)| picture).map_err(|e| e.to_string())
            }
        }
    }
}

fn open(path: &Path) -> Result<Stream<BufReader<File>>, CameraError> {
    let failed = |reason: String| CameraError::Ended { camera: path.display().to_string(), reason };
    let file = File::open(path).map_err(|e| failed(format!("the file cannot be opened: {e}")))?;
    Stream::new(BufReader::new(file)).map_err(|e| failed(e.to_string()))
}

impl Camera for Recording {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
        let now = real_now();
        let until = self.due.min(deadline);
        if until > now {
            std::thread::sleep(Duration::from_micros(until.0 - now.0));
        }
        if real_now() < self.due {
            return Ok(None);
        }
        let picture = self.picture().map_err(|reason| CameraError::Ended { camera: self.name(), reason })?;
        let size = (picture.width, picture.height);
        let first = *self.size.get_or_insert(size);
        if first != size {
            let text = |(width, height): (usize, usize)| format!("{width}x{height}");
            return Err(CameraError::Resized { camera: self.name(), from: text(first), to: text(size) });
        }
        let now = real_now();
        let frame =
            Frame { picture: picture.into(), number: self.number, exposure: Some((self.due, self.due)), arrival: now };
        self.number += 1;
        // Who comes late does not get the missed frames all at once.
        let period = self.period.as_micros() as u64;
        self.due = HostTime((self.due.0 + period).max(now.0.saturating_sub(period)));
        Ok(Some(frame))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::transport::later;

    #[test]
    fn a_file_begins_again_at_its_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.y4m");
        std::fs::write(&path, b"YUV4MPEG2 W2 H1 F500:1 Cmono\nFRAME\n\x01\x02FRAME\n\x03\x04").unwrap();
        let mut camera = Recording::y4m(&path).unwrap();
        let mut seen = Vec::new();
        for _ in 0..5 {
            let frame = camera.next_frame(later(real_now(), 1000)).unwrap().unwrap();
            seen.push((frame.number, frame.picture.view().get(0, 0).unwrap()));
        }
        assert_eq!(seen, [(0, 1), (1, 3), (2, 1), (3, 3), (4, 1)]);
        assert!(Recording::y4m(&folder.path().join("b.y4m")).is_err_and(|e| e.to_string().contains("b.y4m")));
    }

    #[test]
    fn a_folders_pictures_come_in_the_order_of_their_names() {
        let folder = tempfile::tempdir().unwrap();
        assert!(Recording::folder(folder.path()).is_err_and(|e| e.to_string().contains("holds no PNG")));
        for (name, value) in [("b.png", 2u8), ("a.png", 1), ("c.txt", 0)] {
            let path = folder.path().join(name);
            image::GrayImage::from_pixel(3, 2, image::Luma([value]))
                .save_with_format(path, image::ImageFormat::Png)
                .unwrap();
        }
        let mut camera = Recording::folder(folder.path()).unwrap();
        let mut next =
            || camera.next_frame(later(real_now(), 1000)).unwrap().unwrap().picture.view().get(0, 0).unwrap();
        assert_eq!([next(), next(), next()], [1, 2, 1]);
    }
}
