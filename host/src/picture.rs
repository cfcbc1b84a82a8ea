//! A grey picture, borrowed or owned, as cameras deliver it and measures read it.
//!
//! Coordinates are pixels, (0, 0) the top-left one, x to the right and y down.

use thiserror::Error;

/// The pixels of a grey picture, row after row, `stride` pixels from one row to the next.
#[derive(Clone, Copy, Debug)]
pub enum Pixels<'a> {
    /// 8 bits a pixel.
    Grey8(&'a [u8]),
    /// 16 bits a pixel.
    Grey16(&'a [u16]),
}

impl Pixels<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Grey8(p) => p.len(),
            Self::Grey16(p) => p.len(),
        }
    }
}

/// A rectangle of pixels: left, top, width, height.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub struct Roi {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl std::str::FromStr for Roi {
    type Err = PictureError;

    /// Reads `x,y,w,h`.
    fn from_str(s: &str) -> Result<Self, PictureError> {
        let n: Vec<usize> = s
            .split(',')
            .map(|part| part.trim().parse())
            .collect::<Result<_, _>>()
            .map_err(|_| PictureError::RoiSyntax(s.into()))?;
        match n[..] {
            [x, y, width, height] => Ok(Self { x, y, width, height }),
            _ => Err(PictureError::RoiSyntax(s.into())),
        }
    }
}

impl std::fmt::Display for Roi {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{},{},{},{}", self.x, self.y, self.width, self.height)
    }
}

/// Why a picture or a region of one cannot be used.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum PictureError {
    /// The buffer is shorter than the shape says.
    #[error("a picture of {width}x{height} with a stride of {stride} needs {needed} pixels, the buffer holds {held}")]
    TooShort {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Pixels from row to row.
        stride: usize,
        /// Pixels that this shape takes.
        needed: usize,
        /// Pixels there are.
        held: usize,
    },
    /// Width, height or both are zero.
    #[error("the region {0} is empty: give it a width and a height of at least 1")]
    Empty(Roi),
    /// The region leaves the picture.
    #[error("the region {roi} leaves the picture of {width}x{height}: choose one inside it")]
    Outside {
        /// The region asked for.
        roi: Roi,
        /// The picture's columns.
        width: usize,
        /// The picture's rows.
        height: usize,
    },
    /// Not four numbers.
    #[error("'{0}' is not a region: write x,y,width,height in pixels, as in 17,3,25,25")]
    RoiSyntax(String),
}

/// A borrowed grey picture of `width` x `height` pixels.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    pixels: Pixels<'a>,
    width: usize,
    height: usize,
    stride: usize,
}

impl<'a> View<'a> {
    /// A picture whose rows start `stride` pixels apart.
    ///
    /// # Errors
    /// [`PictureError::Empty`] without pixels, [`PictureError::TooShort`] when the buffer ends before the last row does or
    /// `stride` is below `width`.
    pub fn new(pixels: Pixels<'a>, width: usize, height: usize, stride: usize) -> Result<Self, PictureError> {
        if width == 0 || height == 0 {
            return Err(PictureError::Empty(Roi { x: 0, y: 0, width, height }));
        }
        let needed = (height - 1).checked_mul(stride).and_then(|n| n.checked_add(width)).unwrap_or(usize::MAX);
        if needed > pixels.len() || stride < width {
            return Err(PictureError::TooShort { width, height, stride, needed, held: pixels.len() });
        }
        Ok(Self { pixels, width, height, stride })
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Pixels from the start of one row to the start of the next.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// The pixels, from the top-left one of this view.
    pub fn pixels(&self) -> Pixels<'a> {
        self.pixels
    }

    /// Bits of a pixel's type: 8 or 16.
    pub fn bits(&self) -> u32 {
        match self.pixels {
            Pixels::Grey8(_) => 8,
            Pixels::Grey16(_) => 16,
        }
    }

    /// The value at column `x`, row `y`; `None` outside the picture.
    pub fn get(&self, x: usize, y: usize) -> Option<u16> {
        if x >= self.width || y >= self.height {
            return None;
        }
        let i = y * self.stride + x;
        Some(match self.pixels {
            Pixels::Grey8(p) => u16::from(p[i]),
            Pixels::Grey16(p) => p[i],
        })
    }

    /// The part of this picture inside `roi`.
    ///
    /// # Errors
    /// [`PictureError::Empty`] and [`PictureError::Outside`].
    pub fn crop(&self, roi: Roi) -> Result<View<'a>, PictureError> {
        if roi.width == 0 || roi.height == 0 {
            return Err(PictureError::Empty(roi));
        }
        let fits =
            |start: usize, length: usize, whole: usize| start.checked_add(length).is_some_and(|end| end <= whole);
        if !fits(roi.x, roi.width, self.width) || !fits(roi.y, roi.height, self.height) {
            return Err(PictureError::Outside { roi, width: self.width, height: self.height });
        }
        let from = roi.y * self.stride + roi.x;
        let pixels = match self.pixels {
            Pixels::Grey8(p) => Pixels::Grey8(&p[from..]),
            Pixels::Grey16(p) => Pixels::Grey16(&p[from..]),
        };
        View::new(pixels, roi.width, roi.height, self.stride)
    }
}

/// A grey picture of its own, rows without gaps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height` values.
    pub data: Data,
}

/// An owned picture's values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Data {
    /// 8 bits a pixel.
    Grey8(Vec<u8>),
    /// 16 bits a pixel.
    Grey16(Vec<u16>),
}

impl Picture {
    /// An 8-bit picture.
    ///
    /// # Errors
    /// As [`View::new`].
    pub fn grey8(width: usize, height: usize, data: Vec<u8>) -> Result<Self, PictureError> {
        View::new(Pixels::Grey8(&data), width, height, width)?;
        Ok(Self { width, height, data: Data::Grey8(data) })
    }

    /// A 16-bit picture.
    ///
    /// # Errors
    /// As [`View::new`].
    pub fn grey16(width: usize, height: usize, data: Vec<u16>) -> Result<Self, PictureError> {
        View::new(Pixels::Grey16(&data), width, height, width)?;
        Ok(Self { width, height, data: Data::Grey16(data) })
    }

    /// The whole picture, borrowed.
    pub fn view(&self) -> View<'_> {
        let pixels = match &self.data {
            Data::Grey8(d) => Pixels::Grey8(d),
            Data::Grey16(d) => Pixels::Grey16(d),
        };
        View { pixels, width: self.width, height: self.height, stride: self.width }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crop_sees_the_same_pixels_and_none_outside() {
        let picture = Picture::grey8(4, 3, (0..12).collect()).unwrap();
        let crop = picture.view().crop(Roi { x: 1, y: 1, width: 2, height: 2 }).unwrap();
        assert_eq!((crop.get(0, 0), crop.get(1, 1), crop.get(2, 0)), (Some(5), Some(10), None));
    }

    #[test]
    fn impossible_regions_are_refused_by_name() {
        let picture = Picture::grey16(4, 3, vec![0; 12]).unwrap();
        let empty = Roi { x: 0, y: 0, width: 0, height: 2 };
        assert_eq!(picture.view().crop(empty).unwrap_err(), PictureError::Empty(empty));
        for roi in ["3,0,2,1", "0,2,1,2", "18446744073709551615,0,2,1"] {
            assert!(matches!(picture.view().crop(roi.parse().unwrap()), Err(PictureError::Outside { .. })), "{roi}");
        }
        assert!(matches!("1,2,3".parse::<Roi>(), Err(PictureError::RoiSyntax(_))));
    }

    #[test]
    fn buffers_shorter_than_their_shape_are_refused() {
        assert!(matches!(View::new(Pixels::Grey8(&[0; 11]), 4, 3, 4), Err(PictureError::TooShort { .. })));
        assert!(matches!(View::new(Pixels::Grey8(&[0; 11]), 4, 3, 3), Err(PictureError::TooShort { .. })));
        assert!(View::new(Pixels::Grey8(&[0; 9]), 3, 2, 6).is_ok());
    }
}
