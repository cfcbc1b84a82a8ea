//! YUV4MPEG2: uncompressed video as ffmpeg, mjpegtools and GStreamer write it to a pipe. Only the luma is kept.
//!
//! A stream is a header line, then frames: a line that begins with `FRAME`, and the planes. The format is described in
//! the manual page yuv4mpeg(5) of mjpegtools; grey of 9 to 16 bits is ffmpeg's extension (libavformat/yuv4mpegenc.c). Read
//! here rather than by the crate `y4m`, which knows grey of 8 and 12 bits only, and no second header: a program that
//! changes its frames' size begins a new stream in the same pipe, and that must be told.

use crate::picture::Picture;
use std::io::{BufRead, ErrorKind, Read};
use thiserror::Error;

/// Longest header line, bytes.
const LINE: usize = 1024;
/// Largest side of a frame, px.
const SIDE: usize = 32_768;
/// Largest frame, px.
const AREA: usize = 1 << 27;

/// Why a stream gives no frame.
#[derive(Debug, Error)]
pub enum Y4mError {
    /// Not a stream at all.
    #[error(
        "it does not begin with YUV4MPEG2: let the program write that, as in `ffmpeg … -pix_fmt gray -f yuv4mpegpipe -`"
    )]
    NotY4m,
    /// A header that makes no sense.
    #[error("its header says {0}")]
    Header(String),
    /// Something else than FRAME between two frames.
    #[error("frame {0} does not begin with FRAME: something else writes to the same output")]
    OutOfStep(u64),
    /// It ended inside a frame.
    #[error("it ended in the middle of a frame")]
    Cut,
    /// The system.
    #[error("it cannot be read: {0}")]
    Io(#[from] std::io::Error),
}

/// How one pixel's luma is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Depth {
    Byte,
    /// Two bytes, the lower one first.
    Word,
}

/// What a stream's header says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Header {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Frames a second; 0 if the stream does not say.
    pub rate: f64,
    depth: Depth,
    /// Bytes behind the luma: the colour.
    colour: usize,
}

/// A stream, frame after frame.
pub struct Stream<R> {
    reader: R,
    header: Header,
    frames: u64,
}

impl<R: BufRead> Stream<R> {
    /// Reads the stream's header.
    ///
    /// # Errors
    /// [`Y4mError`].
    pub fn new(mut reader: R) -> Result<Self, Y4mError> {
        let line = line(&mut reader)?.ok_or(Y4mError::NotY4m)?;
        let header = header(&line)?;
        Ok(Self { reader, header, frames: 0 })
    }

    /// What the header in force says.
    pub fn header(&self) -> Header {
        self.header
    }

    /// The next frame; `None` at the end.
    ///
    /// # Errors
    /// [`Y4mError`].
    pub fn frame(&mut self) -> Result<Option<Picture>, Y4mError> {
        loop {
            match line(&mut self.reader)? {
                None => return Ok(None),
                Some(text) if text.starts_with(b"YUV4MPEG2") => self.header = header(&text)?,
                Some(text) if text == b"FRAME" || text.starts_with(b"FRAME ") => break,
                Some(_) => return Err(Y4mError::OutOfStep(self.frames)),
            }
        }
        self.frames += 1;
        let Header { width, height, depth, colour, .. } = self.header;
        let pixels = width * height;
        let picture = match depth {
            Depth::Byte => Picture::grey8(width, height, self.bytes(pixels)?),
            Depth::Word => {
                let bytes = self.bytes(2 * pixels)?;
                let words = bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
                Picture::grey16(width, height, words)
            }
        };
        let skipped = std::io::copy(&mut (&mut self.reader).take(colour as u64), &mut std::io::sink())?;
        if skipped < colour as u64 {
            return Err(Y4mError::Cut);
        }
        picture.map(Some).map_err(|e| Y4mError::Header(e.to_string()))
    }

    fn bytes(&mut self, n: usize) -> Result<Vec<u8>, Y4mError> {
        let mut bytes = vec![0; n];
        match self.reader.read_exact(&mut bytes) {
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => Err(Y4mError::Cut),
            other => other.map(|()| bytes).map_err(Y4mError::Io),
        }
    }
}

/// A line without its end; `None` at the end of the stream.
fn line(reader: &mut impl BufRead) -> Result<Option<Vec<u8>>, Y4mError> {
    let mut line = Vec::new();
    reader.take(LINE as u64).read_until(b'\n', &mut line)?;
    match line.pop() {
        None => Ok(None),
        Some(b'\n') => Ok(Some(line)),
        Some(_) if line.len() + 1 < LINE => {
            Err(if line.starts_with(b"YUV4MPEG2") { Y4mError::Cut } else { Y4mError::NotY4m })
        }
        Some(_) => Err(Y4mError::NotY4m),
    }
}

fn header(line: &[u8]) -> Result<Header, Y4mError> {
    let text = std::str::from_utf8(line).map_err(|_| Y4mError::NotY4m)?;
    let mut words = text.split(' ');
    if words.next() != Some("YUV4MPEG2") {
        return Err(Y4mError::NotY4m);
    }
    let (mut width, mut height, mut rate, mut space) = (0, 0, 0.0, "420");
    for word in words.filter(|w| !w.is_empty()) {
        let (key, value) = word.split_at(word.chars().next().map_or(0, char::len_utf8));
        let side = || {
            let side = value.parse().ok().filter(|n| (1..=SIDE).contains(n));
            side.ok_or_else(|| Y4mError::Header(format!("'{word}': a side has 1 to {SIDE} pixels")))
        };
        match key {
            "W" => width = side()?,
            "H" => height = side()?,
            "F" => rate = ratio(value).unwrap_or(0.0),
            "C" => space = value,
            // Interlacing, aspect, comments: no matter for grey values.
            _ => {}
        }
    }
    if width == 0 || height == 0 {
        return Err(Y4mError::Header("no width W or no height H".into()));
    }
    if width * height > AREA {
        return Err(Y4mError::Header(format!("{width}x{height} pixels, which no camera has")));
    }
    let (depth, planes) = colour_space(space, width, height)
        .ok_or_else(|| Y4mError::Header(format!("colour space '{space}', which is not known: use -pix_fmt gray")))?;
    let colour = planes * if depth == Depth::Word { 2 } else { 1 };
    Ok(Header { width, height, rate, depth, colour })
}

/// A positive number written as a fraction.
fn ratio(text: &str) -> Option<f64> {
    let (above, below) = text.split_once(':')?;
    let ratio = above.parse::<u32>().ok().map(f64::from)? / below.parse::<u32>().ok().map(f64::from)?;
    Some(ratio).filter(|r| r.is_finite() && *r > 0.0)
}

/// How luma is kept, and the values of the colour planes behind it.
fn colour_space(space: &str, width: usize, height: usize) -> Option<(Depth, usize)> {
    if let Some(bits) = space.strip_prefix("mono") {
        let bits = if bits.is_empty() { 8 } else { bits.parse().ok()? };
        return Some((depth(bits)?, 0));
    }
    let (layout, bits) = match space.split_once('p').filter(|(_, bits)| bits.parse::<u8>().is_ok()) {
        Some((layout, bits)) => (layout, bits.parse().ok()?),
        None => (space, 8),
    };
    let planes = match layout {
        "420" | "420jpeg" | "420paldv" | "420mpeg2" => 2 * width.div_ceil(2) * height.div_ceil(2),
        "422" => 2 * width.div_ceil(2) * height,
        "411" => 2 * width.div_ceil(4) * height,
        "444" => 2 * width * height,
        "444alpha" => 3 * width * height,
        _ => return None,
    };
    Some((depth(bits)?, planes))
}

fn depth(bits: u8) -> Option<Depth> {
    match bits {
        8 => Some(Depth::Byte),
        9..=16 => Some(Depth::Word),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Data;
    use proptest::prelude::*;

    fn all(bytes: &[u8]) -> Result<Vec<Picture>, Y4mError> {
        let mut stream = Stream::new(bytes)?;
        let mut pictures = Vec::new();
        while let Some(picture) = stream.frame()? {
            pictures.push(picture);
        }
        Ok(pictures)
    }

    #[test]
    fn what_another_writer_writes_is_read() {
        for (space, colour) in [(y4m::Colorspace::Cmono, 0), (y4m::Colorspace::C420, 6), (y4m::Colorspace::C444, 15)] {
            let mut bytes = Vec::new();
            let mut writer =
                y4m::encode(5, 3, y4m::Ratio::new(30, 1)).with_colorspace(space).write_header(&mut bytes).unwrap();
            let luma: Vec<u8> = (0..15).collect();
            let plane = vec![9; colour];
            for _ in 0..3 {
                writer.write_frame(&y4m::Frame::new([&luma, &plane, &plane], None)).unwrap();
            }
            let pictures = all(&bytes).unwrap();
            assert_eq!(pictures, vec![Picture::grey8(5, 3, luma).unwrap(); 3], "{space:?}");
        }
    }

    #[test]
    fn deep_grey_and_a_second_header_are_read() {
        let bytes =
            b"YUV4MPEG2 W2 H1 F25:2 Cmono10\nFRAME\n\x01\x00\xff\x03YUV4MPEG2 W1 H2 F25:2 Cmono\nFRAME Ip\n\x07\x08";
        let mut stream = Stream::new(&bytes[..]).unwrap();
        assert_eq!(stream.header().rate, 12.5);
        assert_eq!(stream.frame().unwrap().unwrap().data, Data::Grey16(vec![1, 1023]));
        let second = stream.frame().unwrap().unwrap();
        assert_eq!((second.width, second.height, second.data), (1, 2, Data::Grey8(vec![7, 8])));
        assert!(stream.frame().unwrap().is_none());
    }

    #[test]
    fn bad_streams_are_named() {
        for (bytes, says) in [
            (&b""[..], "does not begin"),
            (b"RIFF....\n", "does not begin"),
            (b"YUV4MPEG2 W2\n", "no height"),
            (b"YUV4MPEG2 W0 H2\n", "'W0'"),
            (b"YUV4MPEG2 W32768 H32768\n", "no camera"),
            (b"YUV4MPEG2 W2 H2 Cxyz\n", "'xyz'"),
            (b"YUV4MPEG2 W2 H2 Cmono\nFRAME\n\x01", "middle of a frame"),
            (b"YUV4MPEG2 W2 H1 Cmono\nFRAME\n\x01\x02warning: late\n", "does not begin with FRAME"),
        ] {
            let said = all(bytes).unwrap_err().to_string();
            assert!(said.contains(says), "{:?}: {said}", String::from_utf8_lossy(bytes));
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(head in "[ -~]{0,40}", tail in prop::collection::vec(any::<u8>(), 0..200)) {
            // A header that claims a large frame would only cost memory.
            let mut bytes = format!("YUV4MPEG2 W3 H2 {head}\nFRAME\n").into_bytes();
            bytes.extend(&tail);
            let _ = all(&bytes);
            let _ = all(&tail);
        }
    }
}
