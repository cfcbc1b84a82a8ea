//! Frames: from a message to bytes on a wire and back, whatever else the wire carries.

use crate::VERSION;
use crc::{CRC_32_ISCSI, Crc, Table};
use postcard::experimental::max_size::MaxSize;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// CRC-32C with a table of 16 entries: 64 bytes of flash instead of 1 KiB, and fast enough at 12 Mbit/s.
static CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISCSI);

/// Bytes around a message: version before, CRC behind.
const OVERHEAD: usize = 1 + 4;

/// Longest frame without its COBS coding.
pub const MAX_PLAIN: usize =
    max(crate::message::ToBoard::POSTCARD_MAX_SIZE, crate::message::FromBoard::POSTCARD_MAX_SIZE) + OVERHEAD;

/// Longest frame on the wire, its closing zero included.
pub const MAX_FRAME: usize = cobs::max_encoding_length(MAX_PLAIN) + 1;

const fn max(a: usize, b: usize) -> usize {
    if a > b { a } else { b }
}

/// Why a message could not be made into a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncodeError {
    /// The buffer is shorter than the frame: [`MAX_FRAME`] bytes are always enough.
    BufferTooShort,
}

/// Why a frame was thrown away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecodeError {
    /// More bytes than any frame has before its closing zero.
    TooLong,
    /// Not a frame: COBS coding or CRC is wrong. Noise, or a cut-off beginning.
    Damaged,
    /// A sound frame of another protocol version: flash the board or update the host.
    OtherVersion(u8),
    /// A sound frame of this version whose message this build does not know.
    UnknownMessage,
}

/// Writes `message` as one frame into `buffer`; the length comes back.
///
/// # Errors
/// [`EncodeError::BufferTooShort`].
pub fn encode<T: Serialize>(message: &T, buffer: &mut [u8]) -> Result<usize, EncodeError> {
    encode_version(VERSION, message, buffer)
}

/// As [`encode`], with another version byte: for tests of how versions are told apart.
///
/// # Errors
/// As [`encode`].
pub fn encode_version<T: Serialize>(version: u8, message: &T, buffer: &mut [u8]) -> Result<usize, EncodeError> {
    let mut plain = [0; MAX_PLAIN];
    plain[0] = version;
    let end = 1 + postcard::to_slice(message, &mut plain[1..]).map_err(|_| EncodeError::BufferTooShort)?.len();
    let crc = CRC.checksum(&plain[..end]).to_le_bytes();
    plain.get_mut(end..end + 4).ok_or(EncodeError::BufferTooShort)?.copy_from_slice(&crc);
    let needed = cobs::max_encoding_length(end + 4) + 1;
    if buffer.len() < needed {
        return Err(EncodeError::BufferTooShort);
    }
    let n = cobs::encode(&plain[..end + 4], buffer);
    buffer[n] = 0;
    Ok(n + 1)
}

/// Takes bytes one by one and gives messages: after any garbage it is in step again at the next zero byte.
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: [u8; MAX_FRAME],
    len: usize,
    overflowed: bool,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// An empty decoder.
    pub const fn new() -> Self {
        Self { buffer: [0; MAX_FRAME], len: 0, overflowed: false }
    }

    /// Takes one byte. `None` until a frame ends; then its message or what is wrong with it.
    pub fn push<T: DeserializeOwned>(&mut self, byte: u8) -> Option<Result<T, DecodeError>> {
        if byte != 0 {
            match self.buffer.get_mut(self.len) {
                Some(slot) => {
                    *slot = byte;
                    self.len += 1;
                }
                None => self.overflowed = true,
            }
            return None;
        }
        let (len, overflowed) = (self.len, self.overflowed);
        (self.len, self.overflowed) = (0, false);
        if overflowed {
            return Some(Err(DecodeError::TooLong));
        }
        // Zeros between frames are allowed: they wake a peer and end whatever stood before.
        (len > 0).then(|| decode(&mut self.buffer[..len]))
    }
}

/// Reads one frame, without its closing zero, in place.
fn decode<T: DeserializeOwned>(frame: &mut [u8]) -> Result<T, DecodeError> {
    let n = cobs::decode_in_place(frame).map_err(|_| DecodeError::Damaged)?;
    let plain = frame.get(..n).ok_or(DecodeError::Damaged)?;
    let (body, crc) = plain.split_last_chunk::<4>().ok_or(DecodeError::Damaged)?;
    let (version, message) = body.split_first().ok_or(DecodeError::Damaged)?;
    if CRC.checksum(body) != u32::from_le_bytes(*crc) {
        return Err(DecodeError::Damaged);
    }
    if *version != VERSION {
        return Err(DecodeError::OtherVersion(*version));
    }
    match postcard::take_from_bytes(message) {
        Ok((message, [])) => Ok(message),
        _ => Err(DecodeError::UnknownMessage),
    }
}
