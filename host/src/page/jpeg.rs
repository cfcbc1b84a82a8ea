//! A frame as the page shows it: grey values stretched to 8 bits, then JPEG.

use crate::frames::camera::Frame;
use crate::picture::{Data, Picture};
use axum::body::Bytes;
use jpeg_encoder::{Encoder as JpegEncoder, ImageBuffer, JpegColorType, SamplingFactor};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::ops::Range;
use std::sync::Arc;
use std::sync::mpsc::{Sender, channel};
use tokio::sync::oneshot;

/// Which grey values are shown black and white.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Levels {
    /// The darkest and the brightest half per cent of the frame.
    #[default]
    Auto,
    /// The whole scale of its type.
    Full,
    /// These grey values.
    Fixed {
        /// Shown black.
        low: u16,
        /// Shown white.
        high: u16,
    },
}

/// A frame ready to be sent.
#[derive(Clone, Debug)]
pub struct Encoded {
    /// Number of the frame in the feed.
    pub number: u64,
    /// A page's message: the length of a JSON header in 4 bytes, the lower ones first, the header, a JPEG file.
    pub message: Bytes,
    /// Where in it the JPEG file begins.
    begin: usize,
}

impl Encoded {
    /// The JPEG file.
    pub fn jpeg(&self) -> Bytes {
        self.message.slice(self.begin..)
    }
}

/// JPEG's quality, of 100: edges of a tip stay sharp.
const QUALITY: u8 = 85;
/// Pixels looked at to find the levels: every so many.
const EVERY: usize = 7;

/// Makes JPEG files of frames, on one thread that gives way to everything else: pictures for eyes can wait, a scan cannot.
#[derive(Debug)]
pub struct Encoder(Sender<Job>);

#[derive(Debug)]
struct Job {
    number: u64,
    frame: Arc<Frame>,
    levels: Levels,
    answer: oneshot::Sender<Encoded>,
}

impl Default for Encoder {
    fn default() -> Self {
        let (jobs, inbox) = channel::<Job>();
        std::thread::spawn(move || {
            give_way();
            // Kept for several browsers that look at the same.
            let mut last: Option<(Levels, Encoded)> = None;
            while let Ok(job) = inbox.recv() {
                let known = last.take().filter(|(levels, e)| *levels == job.levels && e.number == job.number);
                let encoded = known.map_or_else(|| encode(job.number, &job.frame, job.levels), |(_, encoded)| encoded);
                // Who asked may be gone.
                let _ = job.answer.send(encoded.clone());
                last = Some((job.levels, encoded));
            }
        });
        Self(jobs)
    }
}

impl Encoder {
    /// The frame as JPEG; `None` when the program ends.
    pub async fn encode(&self, number: u64, frame: Arc<Frame>, levels: Levels) -> Option<Encoded> {
        let (answer, answered) = oneshot::channel();
        self.0.send(Job { number, frame, levels, answer }).ok()?;
        answered.await.ok()
    }
}

/// Lowers the calling thread's own priority, where threads have one: when a scan's thread wants the processor, it gets it.
fn give_way() {
    // setpriority(2), notes: on Linux the nice value belongs to the thread, elsewhere to the process. Refused, all is as before.
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(10);
}

/// A picture as the encoder reads it, row by row, stretched.
struct Stretched<'a> {
    picture: &'a Picture,
    stretch: Stretch,
}

impl ImageBuffer for Stretched<'_> {
    fn get_jpeg_color_type(&self) -> JpegColorType {
        JpegColorType::Luma
    }

    fn width(&self) -> u16 {
        // Wider than JPEG can be is refused before.
        self.picture.width as u16
    }

    fn height(&self) -> u16 {
        self.picture.height as u16
    }

    fn fill_buffers(&self, y: u16, buffers: &mut [Vec<u8>; 4]) {
        let width = self.picture.width;
        let row = usize::from(y) * width..(usize::from(y) + 1) * width;
        self.stretch.row(&self.picture.data, row, &mut buffers[0]);
    }
}

/// A frame as a page's message.
fn encode(number: u64, frame: &Frame, levels: Levels) -> Encoded {
    let picture = &*frame.picture;
    let (low, high) = range(picture, levels);
    let (width, height) = (picture.width, picture.height);
    let header = json!({ "frame": number, "width": width, "height": height, "low": low, "high": high }).to_string();
    let mut message = Vec::with_capacity(4 + header.len() + width * height / 4);
    message.extend((header.len() as u32).to_le_bytes());
    message.extend(header.as_bytes());
    let begin = message.len();
    // Writing to memory fails only for pictures larger than JPEG can be: the page then shows nothing.
    if u16::try_from(width).is_ok() && u16::try_from(height).is_ok() {
        let stretch = Stretch::new(picture, (low, high));
        let mut encoder = JpegEncoder::new(&mut message, QUALITY);
        encoder.set_sampling_factor(SamplingFactor::F_1_1);
        let _ = encoder.encode_image(Stretched { picture, stretch });
    }
    Encoded { number, message: message.into(), begin }
}

/// The grey values to be shown black and white; the second is above the first.
fn range(picture: &Picture, levels: Levels) -> (u16, u16) {
    let full = match picture.data {
        Data::Grey8(_) => 255,
        Data::Grey16(_) => u16::MAX,
    };
    let (low, high) = match levels {
        Levels::Full => (0, full),
        Levels::Fixed { low, high } => (low, high),
        Levels::Auto => {
            let mut sample: Vec<u16> = match &picture.data {
                Data::Grey8(data) => data.iter().step_by(EVERY).map(|v| u16::from(*v)).collect(),
                Data::Grey16(data) => data.iter().step_by(EVERY).copied().collect(),
            };
            let (last, part) = (sample.len() - 1, sample.len() / 200);
            let low = *sample.select_nth_unstable(part).1;
            let high = *sample.select_nth_unstable(last - part).1;
            // Noise alone is not blown up to black and white.
            let least = if full == 255 { 12 } else { 1200 };
            let spare = u16::saturating_sub(least, high - low) / 2;
            (low.saturating_sub(spare), high.saturating_add(spare))
        }
    };
    (low.min(full - 1), high.clamp(low.min(full - 1) + 1, full))
}

/// From grey values to what is shown of them.
#[expect(clippy::large_enum_variant, reason = "one of them a frame, on the stack")]
enum Stretch {
    /// By a table, for 8 bits.
    Table([u8; 256]),
    /// By a factor above a value, for 16.
    Factor(u16, f32),
}

impl Stretch {
    fn new(picture: &Picture, (low, high): (u16, u16)) -> Self {
        let factor = 255.0 / f32::from(high - low);
        match picture.data {
            Data::Grey8(_) => Self::Table(std::array::from_fn(|v| stretched(v as u16, low, factor))),
            Data::Grey16(_) => Self::Factor(low, factor),
        }
    }

    fn row(&self, data: &Data, row: Range<usize>, to: &mut Vec<u8>) {
        match (self, data) {
            (Self::Table(table), Data::Grey8(data)) => to.extend(data[row].iter().map(|v| table[usize::from(*v)])),
            (Self::Factor(low, factor), Data::Grey16(data)) => {
                to.extend(data[row].iter().map(|v| stretched(*v, *low, *factor)));
            }
            // Made for the picture's own type.
            _ => to.resize(to.len() + row.len(), 0),
        }
    }
}

fn stretched(value: u16, low: u16, factor: f32) -> u8 {
    (f32::from(value.saturating_sub(low)) * factor + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use parfocal_protocol::units::HostTime;

    #[test]
    fn a_frame_is_stretched_to_black_and_white() {
        let picture = Picture::grey16(100, 10, (0..1000).map(|v| 20_000 + 10 * v).collect()).unwrap();
        let (low, high) = range(&picture, Levels::Auto);
        assert!((20_000..20_200).contains(&low) && (29_800..30_000).contains(&high), "{low} {high}");
        let mut grey = Vec::new();
        Stretch::new(&picture, (low, high)).row(&picture.data, 0..1000, &mut grey);
        assert_eq!((grey.len(), grey[0], grey[999]), (1000, 0, 255));
        assert_eq!(range(&picture, Levels::Fixed { low: 9, high: 3 }), (9, 10));
        assert_eq!(range(&picture, Levels::Fixed { low: u16::MAX, high: 0 }), (u16::MAX - 1, u16::MAX));
        let flat = Picture::grey8(3, 3, vec![200; 9]).unwrap();
        assert_eq!(range(&flat, Levels::Auto), (194, 206));
    }

    #[test]
    fn what_is_encoded_is_a_jpeg_of_the_same_picture() {
        // Neither side a multiple of the encoder's blocks.
        let grey8 = Picture::grey8(61, 47, (0..61 * 47).map(|i| ((i % 61) * 4) as u8).collect());
        let grey16 = Picture::grey16(61, 47, (0..61 * 47).map(|i| ((i % 61) * 4 * 257) as u16).collect());
        for picture in [grey8.unwrap(), grey16.unwrap()] {
            let frame = Frame { picture: picture.into(), number: 0, exposure: None, arrival: HostTime(0) };
            let encoded = encode(7, &frame, Levels::Full);
            let back = image::load_from_memory(&encoded.jpeg()).unwrap().to_luma8();
            assert_eq!(back.dimensions(), (61, 47));
            let worst = back.enumerate_pixels().map(|(x, _, p)| (i32::from(p.0[0]) - 4 * x as i32).abs()).max();
            assert!(worst < Some(12), "{worst:?}");
            let (length, rest) = encoded.message.split_at(4);
            let length = u32::from_le_bytes(length.try_into().unwrap()) as usize;
            let header: serde_json::Value = serde_json::from_slice(&rest[..length]).unwrap();
            assert_eq!((&header["frame"], &header["width"]), (&json!(7), &json!(61)));
            assert_eq!(rest[length..], encoded.jpeg());
        }
    }

    #[test]
    fn a_picture_larger_than_jpeg_can_be_gives_none() {
        let picture = Picture::grey8(70_000, 1, vec![0; 70_000]).unwrap().into();
        let frame = Frame { picture, number: 0, exposure: None, arrival: HostTime(0) };
        assert!(encode(1, &frame, Levels::Auto).jpeg().is_empty());
    }

    #[tokio::test]
    async fn the_thread_answers_everyone_and_knows_what_it_encoded_last() {
        let picture = Arc::new(Picture::grey8(16, 16, vec![9; 256]).unwrap());
        let frame = Arc::new(Frame { picture, number: 0, exposure: None, arrival: HostTime(0) });
        let encoder = Encoder::default();
        let one = encoder.encode(1, frame.clone(), Levels::Full).await.unwrap();
        let same = encoder.encode(1, frame.clone(), Levels::Full).await.unwrap();
        assert_eq!(one.message.as_ptr(), same.message.as_ptr());
        let other = encoder.encode(1, frame, Levels::Auto).await.unwrap();
        assert_ne!(one.message, other.message);
    }
}
