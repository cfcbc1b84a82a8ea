//! A focal stack on disk: a folder of pictures, or one multi-page TIFF, with a `stack.toml` beside the planes.

use super::image_file::{self, ImageFileError, Note};
use crate::picture::{Picture, PictureError, Roi};
use parfocal_protocol::units::Micrometres;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A focal stack: pictures of one shape at evenly spaced heights.
#[derive(Clone, Debug)]
pub struct Stack {
    /// Where it was read from.
    pub path: PathBuf,
    /// Planes, by growing z.
    pub planes: Vec<Picture>,
    /// What `stack.toml` says.
    pub about: About,
    /// What was done to the pictures on reading (colour to grey), if anything.
    pub note: Option<Note>,
}

/// The contents of `stack.toml`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct About {
    /// Distance between neighbouring planes, µm.
    pub z_step_um: f64,
    /// z of the first plane, µm.
    #[serde(default)]
    pub first_z_um: f64,
    /// Pixel size in µm along x and y.
    pub pixel_um: Option<[f64; 2]>,
    /// x, y, width, height of the region whose focus matters.
    pub roi_px: Option<[usize; 4]>,
    /// What is known of the true focus.
    pub truth: Option<Truth>,
}

/// What is known of a stack's true focus.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    /// The plane in focus, from 0.
    pub plane: Option<usize>,
    /// The pipette's tip: column, row.
    pub tip_px: Option<[f64; 2]>,
}

/// Why a stack cannot be used.
#[derive(Debug, Error)]
pub enum StackError {
    /// A plane's file.
    #[error(transparent)]
    Image(#[from] ImageFileError),
    /// The folder or `stack.toml` cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// There is no `stack.toml`.
    #[error("{}: is missing; write one with at least `z_step_um = …`, the distance between planes", .0.display())]
    NoAbout(PathBuf),
    /// `stack.toml` is not TOML, or lacks a key.
    #[error("{}: {reason}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        reason: String,
    },
    /// A value that cannot be.
    #[error("{}: {key} = {value}: {rule}", path.display())]
    Absurd {
        /// The file.
        path: PathBuf,
        /// The key.
        key: &'static str,
        /// Its value.
        value: String,
        /// What it must be.
        rule: &'static str,
    },
    /// The region of interest does not fit the pictures.
    #[error("{}: roi_px: {source}", path.display())]
    Region {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: PictureError,
    },
    /// No pictures there.
    #[error("{}: holds no PNG, TIFF or JPEG pictures", .0.display())]
    Empty(PathBuf),
    /// Two planes of different shape.
    #[error("{}: is {found}, the planes before it are {expected}: all planes must be alike", path.display())]
    Unlike {
        /// The plane's file, or the file and its page.
        path: PathBuf,
        /// Its shape.
        found: String,
        /// The first plane's.
        expected: String,
    },
}

impl Stack {
    /// Reads a stack from a folder, or from one multi-page TIFF with its `stack.toml` beside it.
    ///
    /// In a folder with pictures in several formats those of the format with the most files are the planes, in name order.
    ///
    /// # Errors
    /// [`StackError`], which names the file and the key.
    pub fn open(path: &Path) -> Result<Self, StackError> {
        if let Err(source) = path.metadata() {
            return Err(StackError::Read { path: path.into(), source });
        }
        let folder = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new(".")) };
        let files = if path.is_dir() { planes_of(path)? } else { vec![path.to_path_buf()] };
        let about_path = folder.join("stack.toml");
        let about = About::read(&about_path)?;
        let (mut planes, mut note) = (Vec::new(), None);
        if let [file] = &files[..] {
            (planes, note) = image_file::read_pages(file)?;
        } else {
            for file in &files {
                let (picture, said) = image_file::read(file)?;
                planes.push(picture);
                note = note.or(said);
            }
        }
        let first = planes.first().map(shape).ok_or_else(|| StackError::Empty(path.into()))?;
        if let Some((i, odd)) = planes.iter().enumerate().find(|(_, p)| shape(p) != first) {
            let path =
                if files.len() == 1 { format!("{} page {i}", files[0].display()).into() } else { files[i].clone() };
            return Err(StackError::Unlike { path, found: shape(odd), expected: first });
        }
        about.check(&about_path, &planes)?;
        Ok(Self { path: path.into(), planes, about, note })
    }

    /// z of a plane.
    pub fn z(&self, plane: usize) -> Micrometres {
        Micrometres(self.about.first_z_um + plane as f64 * self.about.z_step_um)
    }

    /// z of the first and of the last plane.
    pub fn extent(&self) -> (Micrometres, Micrometres) {
        (self.z(0), self.z(self.planes.len() - 1))
    }

    /// The region whose focus matters, if `stack.toml` names one.
    pub fn roi(&self) -> Option<Roi> {
        self.about.roi_px.map(|[x, y, width, height]| Roi { x, y, width, height })
    }

    /// The plane nearest to `z`: what is shown.
    pub fn nearest(&self, z: Micrometres) -> usize {
        let k = ((z.0 - self.about.first_z_um) / self.about.z_step_um).round();
        // Negative and NaN become 0.
        (k as usize).min(self.planes.len() - 1)
    }

    /// Linear interpolation in z between per-plane values; beyond the ends the end's value holds.
    /// Values are interpolated, not pictures: blended pictures have maxima that neither plane has.
    pub fn between(&self, values: &[f64], z: Micrometres) -> Option<f64> {
        let last = values.len().checked_sub(1)?;
        let k = ((z.0 - self.about.first_z_um) / self.about.z_step_um).clamp(0.0, last as f64);
        let (below, part) = (k.floor() as usize, k.fract());
        let above = (below + 1).min(last);
        Some(values[below] + (values[above] - values[below]) * part)
    }
}

fn shape(picture: &Picture) -> String {
    format!("{}x{} of {} bits", picture.width, picture.height, picture.view().bits())
}

/// The pictures of a folder that are its planes, in name order.
fn planes_of(folder: &Path) -> Result<Vec<PathBuf>, StackError> {
    let unreadable = |source| StackError::Read { path: folder.into(), source };
    let mut formats: [Vec<PathBuf>; 3] = Default::default();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
        let format = match extension.as_str() {
            "png" => 0,
            "tif" | "tiff" => 1,
            "jpg" | "jpeg" => 2,
            _ => continue,
        };
        formats[format].push(path);
    }
    // Of equals the first of the list above.
    let mut planes = formats.into_iter().rev().max_by_key(Vec::len).unwrap_or_default();
    planes.sort();
    if planes.is_empty() { Err(StackError::Empty(folder.into())) } else { Ok(planes) }
}

impl About {
    fn read(path: &Path) -> Result<Self, StackError> {
        let text = std::fs::read_to_string(path).map_err(|source| match source.kind() {
            std::io::ErrorKind::NotFound => StackError::NoAbout(path.into()),
            _ => StackError::Read { path: path.into(), source },
        })?;
        toml::from_str(&text)
            .map_err(|e| StackError::Syntax { path: path.into(), reason: e.to_string().trim_end().replace('\n', "; ") })
    }

    fn check(&self, path: &Path, planes: &[Picture]) -> Result<(), StackError> {
        let absurd = |key, value: String, rule| StackError::Absurd { path: path.into(), key, value, rule };
        if !(1e-3..=1e4).contains(&self.z_step_um) {
            return Err(absurd("z_step_um", self.z_step_um.to_string(), "must lie between 0.001 and 10000 µm"));
        }
        if !(self.first_z_um.abs() <= 1e6) {
            return Err(absurd("first_z_um", self.first_z_um.to_string(), "must lie between -1000000 and 1000000 µm"));
        }
        if let Some(size) = self.pixel_um
            && !size.iter().all(|s| (1e-4..=1e4).contains(s))
        {
            return Err(absurd("pixel_um", format!("{size:?}"), "both must lie between 0.0001 and 10000 µm"));
        }
        let first = planes[0].view();
        if let Some([x, y, width, height]) = self.roi_px {
            let region = |source| StackError::Region { path: path.into(), source };
            first.crop(Roi { x, y, width, height }).map_err(region)?;
        }
        let Some(truth) = &self.truth else { return Ok(()) };
        if let Some(plane) = truth.plane
            && plane >= planes.len()
        {
            return Err(absurd("truth.plane", plane.to_string(), "must be one of the planes, counted from 0"));
        }
        if let Some([x, y]) = truth.tip_px
            && !(x.is_finite() && y.is_finite())
        {
            return Err(absurd("truth.tip_px", format!("[{x}, {y}]"), "must be finite"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder with `planes` of the given widths and this `stack.toml`.
    fn folder(widths: &[u32], about: Option<&str>) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        for (i, w) in widths.iter().enumerate() {
            image::GrayImage::from_pixel(*w, 4, image::Luma([10 * i as u8]))
                .save(dir.path().join(format!("z{i:03}.png")))
                .unwrap();
        }
        if let Some(text) = about {
            std::fs::write(dir.path().join("stack.toml"), text).unwrap();
        }
        dir
    }

    fn refusal(widths: &[u32], about: Option<&str>) -> String {
        Stack::open(folder(widths, about).path()).unwrap_err().to_string()
    }

    #[test]
    fn planes_come_in_name_order_with_their_heights() {
        let dir = folder(&[4, 4, 4], Some("z_step_um = 0.5\nfirst_z_um = -1.0\nroi_px = [1, 1, 2, 2]"));
        let stack = Stack::open(dir.path()).unwrap();
        assert_eq!(stack.planes.iter().map(|p| p.view().get(0, 0).unwrap()).collect::<Vec<_>>(), [0, 10, 20]);
        assert_eq!(stack.extent(), (Micrometres(-1.0), Micrometres(0.0)));
        assert_eq!([-9.0, -0.76, -0.74, 9.0].map(|z| stack.nearest(Micrometres(z))), [0, 0, 1, 2]);
        assert_eq!(stack.roi(), Some(Roi { x: 1, y: 1, width: 2, height: 2 }));
    }

    #[test]
    fn values_between_planes_lie_on_the_line() {
        let stack = Stack::open(folder(&[4, 4, 4], Some("z_step_um = 2.0")).path()).unwrap();
        let at = |z| stack.between(&[1.0, 5.0, 3.0], Micrometres(z)).unwrap();
        assert_eq!([-1.0, 0.0, 0.5, 2.0, 3.0, 4.0, 9.0].map(at), [1.0, 1.0, 2.0, 5.0, 4.0, 3.0, 3.0]);
        assert_eq!(stack.between(&[], Micrometres(0.0)), None);
    }

    #[test]
    fn every_bad_folder_gets_a_sentence_with_file_and_key() {
        assert!(refusal(&[], Some("z_step_um = 1.0")).contains("holds no PNG, TIFF or JPEG"));
        assert!(refusal(&[4, 4], None).contains("stack.toml: is missing"));
        assert!(refusal(&[4, 5], Some("z_step_um = 1.0")).contains("z001.png: is 5x4"));
        assert!(refusal(&[4], Some("first_z_um = 1.0")).contains("z_step_um"));
        assert!(refusal(&[4], Some("z_step_um = 0")).contains("z_step_um = 0: must lie"));
        assert!(refusal(&[4], Some("z_step_um = nan")).contains("z_step_um = NaN"));
        assert!(refusal(&[4], Some("z_step_um = 1.0\nfirst_z_um = inf")).contains("first_z_um = inf"));
        assert!(refusal(&[4], Some("z_step_um = 1.0\nroi_px = [3, 0, 2, 1]")).contains("roi_px"));
        assert!(refusal(&[4], Some("z_step_um = 1.0\n[truth]\nplane = 1")).contains("truth.plane = 1"));
        assert!(refusal(&[4], Some("z_step_um = = 1")).contains("stack.toml"));
        assert!(
            Stack::open(Path::new("no/such/folder"))
                .unwrap_err()
                .to_string()
                .contains("no/such/folder: cannot be read")
        );
    }
}
