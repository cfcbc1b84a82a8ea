//! Buffers as V4L2 devices fill them, as grey pictures.
//!
//! The layouts are those of the Linux kernel's documentation, "Userspace API, Video for Linux, image formats"
//! (<https://docs.kernel.org/userspace-api/media/v4l/pixfmt.html>). Of colour only the luma is kept.

use crate::picture::Picture;
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// How pixels lie in a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RawFormat {
    /// 8 bits of grey.
    Grey,
    /// 16 bits of grey, the lower byte first.
    Y16,
    /// 12 bits of grey in 16.
    Y12,
    /// 10 bits of grey in 16.
    Y10,
    /// Luma and colour in turn, luma first.
    Yuyv,
    /// Luma and colour in turn, colour first.
    Uyvy,
    /// All luma, then the colours.
    Nv12,
    /// All luma, then one colour, then the other.
    Yu12,
    /// A JPEG file a frame.
    Mjpg,
}

impl RawFormat {
    /// From the one that keeps most of the sensor's grey values and costs least, to the one that loses most.
    pub const ALL: [Self; 9] =
        [Self::Grey, Self::Y16, Self::Y12, Self::Y10, Self::Nv12, Self::Yu12, Self::Yuyv, Self::Uyvy, Self::Mjpg];

    /// Its four characters (`linux/videodev2.h`).
    pub fn fourcc(self) -> [u8; 4] {
        *match self {
            Self::Grey => b"GREY",
            Self::Y16 => b"Y16 ",
            Self::Y12 => b"Y12 ",
            Self::Y10 => b"Y10 ",
            Self::Yuyv => b"YUYV",
            Self::Uyvy => b"UYVY",
            Self::Nv12 => b"NV12",
            Self::Yu12 => b"YU12",
            Self::Mjpg => b"MJPG",
        }
    }
}

impl fmt::Display for RawFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(String::from_utf8_lossy(&self.fourcc()).trim_end())
    }
}

impl FromStr for RawFormat {
    type Err = ();

    fn from_str(s: &str) -> Result<Self, ()> {
        Self::ALL.into_iter().find(|format| format.to_string() == s).ok_or(())
    }
}

/// What a device has agreed to deliver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// How pixels lie.
    pub format: RawFormat,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Bytes from one row of luma to the next; 0: rows without gaps.
    pub stride: usize,
}

/// A buffer that is no picture. Cables do that now and then; the next buffer may be one.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum Damaged {
    /// It ends too early.
    #[error("a frame of {held} bytes came, {needed} make one")]
    Short {
        /// Bytes that came.
        held: usize,
        /// Bytes of a whole one.
        needed: usize,
    },
    /// No JPEG file, or a cut one.
    #[error("a frame is no whole JPEG file: {0}")]
    Jpeg(String),
    /// A JPEG file of another size.
    #[error("a JPEG file of {0}x{1} came in a stream of another size")]
    Size(u32, u32),
}

/// A buffer's picture.
///
/// # Errors
/// [`Damaged`].
pub fn picture(layout: Layout, bytes: &[u8]) -> Result<Picture, Damaged> {
    let Layout { format, width, height, .. } = layout;
    let grey8 = |data: Vec<u8>| Picture::grey8(width, height, data);
    let made = match format {
        RawFormat::Grey | RawFormat::Nv12 | RawFormat::Yu12 => {
            grey8(rows(layout, bytes, 1)?.flatten().copied().collect())
        }
        RawFormat::Yuyv => grey8(rows(layout, bytes, 2)?.flat_map(|row| row.iter().step_by(2)).copied().collect()),
        RawFormat::Uyvy => {
            grey8(rows(layout, bytes, 2)?.flat_map(|row| row.iter().skip(1).step_by(2)).copied().collect())
        }
        RawFormat::Y16 | RawFormat::Y12 | RawFormat::Y10 => {
            let words = rows(layout, bytes, 2)?.flat_map(|row| row.chunks_exact(2));
            Picture::grey16(width, height, words.map(|word| u16::from_le_bytes([word[0], word[1]])).collect())
        }
        RawFormat::Mjpg => {
            let read = image::load_from_memory_with_format(bytes, image::ImageFormat::Jpeg);
            let luma = read.map_err(|e| Damaged::Jpeg(e.to_string()))?.into_luma8();
            if (luma.width() as usize, luma.height() as usize) != (width, height) {
                return Err(Damaged::Size(luma.width(), luma.height()));
            }
            grey8(luma.into_raw())
        }
    };
    // Rows make exactly one picture; one without pixels no device agrees to.
    made.map_err(|_| Damaged::Short { held: bytes.len(), needed: 1 })
}

/// The rows of a buffer's luma, gaps at their ends left out.
fn rows(layout: Layout, bytes: &[u8], of_pixel: usize) -> Result<impl Iterator<Item = &[u8]>, Damaged> {
    let long = layout.width * of_pixel;
    let stride = layout.stride.max(long);
    let needed = layout.height.saturating_sub(1).saturating_mul(stride).saturating_add(long);
    if bytes.len() < needed || long == 0 {
        return Err(Damaged::Short { held: bytes.len(), needed });
    }
    Ok(bytes.chunks(stride).take(layout.height).map(move |row| &row[..long]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Data;
    use proptest::prelude::*;

    /// A buffer of `layout` in which the luma of column x, row y is `luma(x, y)`, written the other way round: pixel by pixel.
    fn buffer(layout: Layout, luma: impl Fn(usize, usize) -> u16) -> Vec<u8> {
        let Layout { format, width, height, stride } = layout;
        let mut bytes = vec![0xEE; stride * height * 2];
        for (x, y) in (0..width).flat_map(|x| (0..height).map(move |y| (x, y))) {
            let value = luma(x, y);
            match format {
                RawFormat::Grey | RawFormat::Nv12 | RawFormat::Yu12 | RawFormat::Mjpg => {
                    bytes[y * stride + x] = value as u8
                }
                RawFormat::Yuyv => bytes[y * stride + 2 * x] = value as u8,
                RawFormat::Uyvy => bytes[y * stride + 2 * x + 1] = value as u8,
                RawFormat::Y16 | RawFormat::Y12 | RawFormat::Y10 => {
                    bytes[y * stride + 2 * x..][..2].copy_from_slice(&value.to_le_bytes());
                }
            }
        }
        bytes
    }

    proptest! {
        #[test]
        fn every_pixel_is_where_its_format_has_it(
            index in 0..8usize, width in 1..9usize, height in 1..7usize, gap in 0..5usize, seed in any::<u16>()
        ) {
            let format = RawFormat::ALL[index];
            let stride = 2 * width + gap;
            let layout = Layout { format, width, height, stride };
            let wide = matches!(format, RawFormat::Y16 | RawFormat::Y12 | RawFormat::Y10);
            let luma = |x: usize, y: usize| {
                let value = seed.wrapping_mul(31).wrapping_add((x * 57 + y * 1013) as u16);
                if wide { value } else { value & 0xFF }
            };
            let picture = picture(layout, &buffer(layout, luma)).unwrap();
            prop_assert_eq!((picture.width, picture.height), (width, height));
            for (x, y) in (0..width).flat_map(|x| (0..height).map(move |y| (x, y))) {
                prop_assert_eq!(picture.view().get(x, y), Some(luma(x, y)));
            }
        }

        #[test]
        fn no_buffer_makes_it_panic(index in 0..9usize, bytes in prop::collection::vec(any::<u8>(), 0..80), stride in 0..20usize) {
            let layout = Layout { format: RawFormat::ALL[index], width: 4, height: 3, stride };
            let _ = picture(layout, &bytes);
        }
    }

    #[test]
    fn a_buffer_that_ends_early_is_told_with_its_size() {
        let layout = Layout { format: RawFormat::Yuyv, width: 4, height: 2, stride: 10 };
        assert_eq!(picture(layout, &[0; 17]), Err(Damaged::Short { held: 17, needed: 18 }));
        assert!(picture(layout, &[0; 18]).is_ok(), "the last row needs no gap");
    }

    #[test]
    fn a_jpeg_frame_is_read_and_one_of_another_size_refused() {
        let mut file = Vec::new();
        let grey = image::GrayImage::from_fn(16, 8, |x, _| image::Luma([(x * 12) as u8]));
        grey.write_to(&mut std::io::Cursor::new(&mut file), image::ImageFormat::Jpeg).unwrap();
        let layout = Layout { format: RawFormat::Mjpg, width: 16, height: 8, stride: 0 };
        let Data::Grey8(data) = picture(layout, &file).unwrap().data else { panic!("8 bits") };
        assert!(data.iter().zip(grey.iter()).all(|(a, b)| a.abs_diff(*b) < 12));
        assert_eq!(picture(Layout { width: 8, ..layout }, &file), Err(Damaged::Size(16, 8)));
        assert!(matches!(picture(layout, &file[..60]), Err(Damaged::Jpeg(_))));
    }
}
