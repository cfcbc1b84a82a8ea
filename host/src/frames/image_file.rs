//! One image file as grey pictures: PNG, JPEG, and TIFF with one page or many.
//!
//! What the file holds decides, not its name. 8- and 16-bit grey is taken as it is; colour becomes luma (ITU-R BT.601,
//! 0.299 R + 0.587 G + 0.114 B) and the caller is told; anything whose grey values would have to be guessed is refused.

use crate::picture::{Picture, PictureError};
use image::{DynamicImage, ImageFormat, ImageReader};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use thiserror::Error;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult};

/// What was done to a file's pixels before they became a grey picture: to be passed on to the person.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Note {
    /// Red, green and blue were weighed into luma.
    ColourToGrey,
    /// Grey with an alpha channel, which was dropped.
    AlphaDropped,
    /// Colour with an alpha channel: weighed into luma, alpha dropped.
    ColourToGreyAlphaDropped,
}

impl std::fmt::Display for Note {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::ColourToGrey => "colour, converted to grey by BT.601 luma",
            Self::AlphaDropped => "its alpha channel is ignored",
            Self::ColourToGreyAlphaDropped => "colour, converted to grey by BT.601 luma; its alpha channel is ignored",
        })
    }
}

/// Why a file gave no picture.
#[derive(Debug, Error)]
pub enum ImageFileError {
    /// The file cannot be opened or read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Neither PNG nor JPEG nor TIFF.
    #[error("{}: is no PNG, JPEG or TIFF file", path.display())]
    NotAnImage {
        /// The file.
        path: PathBuf,
    },
    /// The file is damaged or uses a variant that the decoder does not know.
    #[error("{}: cannot be decoded: {reason}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// What the decoder says.
        reason: String,
    },
    /// Pixels of a kind that is neither grey nor colour of 8 or 16 bits.
    #[error("{}: holds {kind} pixels; save it as 8- or 16-bit grey", path.display())]
    Pixels {
        /// The file.
        path: PathBuf,
        /// As in 'floating-point'.
        kind: String,
    },
    /// A page without pixels.
    #[error("{}: {source}", path.display())]
    Shape {
        /// The file.
        path: PathBuf,
        /// What is wrong with its shape.
        source: PictureError,
    },
}

/// Reads one picture: of a TIFF with many pages, the first.
///
/// # Errors
/// [`ImageFileError`], which names the file and what to do.
pub fn read(path: &Path) -> Result<(Picture, Option<Note>), ImageFileError> {
    let reader = open(path)?;
    match reader.format() {
        Some(ImageFormat::Tiff) => Pages::open(path, reader.into_inner())?.read(),
        Some(_) => decode(path, reader),
        None => Err(ImageFileError::NotAnImage { path: path.into() }),
    }
}

/// Reads all pages of a TIFF, or the one picture of a PNG or JPEG. The note is that of the first page that has one.
///
/// # Errors
/// [`ImageFileError`]; one unreadable page fails the whole file, for planes must not be missing silently.
pub fn read_pages(path: &Path) -> Result<(Vec<Picture>, Option<Note>), ImageFileError> {
    let reader = open(path)?;
    if reader.format() != Some(ImageFormat::Tiff) {
        let (picture, note) = read(path)?;
        return Ok((vec![picture], note));
    }
    let mut file = Pages::open(path, reader.into_inner())?;
    let (mut pictures, mut first_note) = (Vec::new(), None);
    loop {
        let (picture, note) = file.read()?;
        pictures.push(picture);
        first_note = first_note.or(note);
        if !file.next()? {
            return Ok((pictures, first_note));
        }
    }
}

type Source = BufReader<File>;

fn open(path: &Path) -> Result<ImageReader<Source>, ImageFileError> {
    ImageReader::open(path)
        .and_then(ImageReader::with_guessed_format)
        .map_err(|source| ImageFileError::Read { path: path.into(), source })
}

/// PNG and JPEG.
fn decode(path: &Path, reader: ImageReader<Source>) -> Result<(Picture, Option<Note>), ImageFileError> {
    let decoded = reader.decode().map_err(|e| ImageFileError::Decode { path: path.into(), reason: e.to_string() })?;
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let unfit = |kind: &str| ImageFileError::Pixels { path: path.into(), kind: kind.into() };
    let (samples, channels) = match decoded {
        DynamicImage::ImageLuma8(p) => (Samples::Bits8(p.into_raw()), Channels::Grey),
        DynamicImage::ImageLuma16(p) => (Samples::Bits16(p.into_raw()), Channels::Grey),
        DynamicImage::ImageLumaA8(p) => (Samples::Bits8(p.into_raw()), Channels::GreyAlpha),
        DynamicImage::ImageLumaA16(p) => (Samples::Bits16(p.into_raw()), Channels::GreyAlpha),
        DynamicImage::ImageRgb8(p) => (Samples::Bits8(p.into_raw()), Channels::Colour),
        DynamicImage::ImageRgb16(p) => (Samples::Bits16(p.into_raw()), Channels::Colour),
        DynamicImage::ImageRgba8(p) => (Samples::Bits8(p.into_raw()), Channels::ColourAlpha),
        DynamicImage::ImageRgba16(p) => (Samples::Bits16(p.into_raw()), Channels::ColourAlpha),
        DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => return Err(unfit("floating-point")),
        _ => return Err(unfit("unusual")),
    };
    picture(path, samples, channels, width, height)
}

/// A TIFF file, page after page.
struct Pages<'p> {
    path: &'p Path,
    decoder: Decoder<Source>,
}

impl<'p> Pages<'p> {
    fn open(path: &'p Path, source: Source) -> Result<Self, ImageFileError> {
        let decoder = Decoder::new(source).map_err(|e| Self::broken(path, e))?;
        Ok(Self { path, decoder })
    }

    fn broken(path: &Path, error: tiff::TiffError) -> ImageFileError {
        ImageFileError::Decode { path: path.into(), reason: error.to_string() }
    }

    /// Goes on to the next page; `false` after the last.
    fn next(&mut self) -> Result<bool, ImageFileError> {
        let more = self.decoder.more_images();
        if more {
            self.decoder.next_image().map_err(|e| Self::broken(self.path, e))?;
        }
        Ok(more)
    }

    fn read(&mut self) -> Result<(Picture, Option<Note>), ImageFileError> {
        let path = self.path;
        let broken = |e| Self::broken(path, e);
        let (width, height) = self.decoder.dimensions().map_err(broken)?;
        let colour = self.decoder.colortype().map_err(broken)?;
        let unfit = |kind: String| ImageFileError::Pixels { path: path.into(), kind };
        let channels = match colour {
            ColorType::Gray(8 | 16) => Channels::Grey,
            ColorType::GrayA(8 | 16) => Channels::GreyAlpha,
            ColorType::RGB(8 | 16) => Channels::Colour,
            ColorType::RGBA(8 | 16) => Channels::ColourAlpha,
            ColorType::Gray(bits) | ColorType::RGB(bits) => {
                return Err(unfit(format!("{bits}-bit or floating-point")));
            }
            other => return Err(unfit(format!("{other:?}"))),
        };
        let samples = match self.decoder.read_image().map_err(broken)? {
            DecodingResult::U8(p) => Samples::Bits8(p),
            DecodingResult::U16(p) => Samples::Bits16(p),
            DecodingResult::I8(_) | DecodingResult::I16(_) => return Err(unfit("signed integer".into())),
            _ => return Err(unfit("floating-point".into())),
        };
        picture(path, samples, channels, width as usize, height as usize)
    }
}

/// Interleaved samples of a decoded file.
enum Samples {
    Bits8(Vec<u8>),
    Bits16(Vec<u16>),
}

#[derive(Clone, Copy)]
enum Channels {
    Grey,
    GreyAlpha,
    Colour,
    ColourAlpha,
}

impl Channels {
    fn note(self) -> Option<Note> {
        match self {
            Self::Grey => None,
            Self::GreyAlpha => Some(Note::AlphaDropped),
            Self::Colour => Some(Note::ColourToGrey),
            Self::ColourAlpha => Some(Note::ColourToGreyAlphaDropped),
        }
    }

    fn to_grey<T: Copy + Into<u32> + TryFrom<u32>>(self, samples: Vec<T>) -> Vec<T> {
        match self {
            Self::Grey => samples,
            Self::GreyAlpha => samples.chunks_exact(2).map(|p| p[0]).collect(),
            Self::Colour => samples.chunks_exact(3).map(luma).collect(),
            Self::ColourAlpha => samples.chunks_exact(4).map(luma).collect(),
        }
    }
}

/// BT.601 luma in 16-bit fixed point, rounded; the weights add up to 65,536, so white stays white.
fn luma<T: Copy + Into<u32> + TryFrom<u32>>(rgb: &[T]) -> T {
    let [r, g, b] = [rgb[0].into(), rgb[1].into(), rgb[2].into()];
    T::try_from((19_595 * r + 38_470 * g + 7_471 * b + 32_768) >> 16).unwrap_or(rgb[1])
}

fn picture(
    path: &Path,
    samples: Samples,
    channels: Channels,
    width: usize,
    height: usize,
) -> Result<(Picture, Option<Note>), ImageFileError> {
    let picture = match samples {
        Samples::Bits8(p) => Picture::grey8(width, height, channels.to_grey(p)),
        Samples::Bits16(p) => Picture::grey16(width, height, channels.to_grey(p)),
    };
    let picture = picture.map_err(|source| ImageFileError::Shape { path: path.into(), source })?;
    Ok((picture, channels.note()))
}

#[cfg(test)]
mod tests;
