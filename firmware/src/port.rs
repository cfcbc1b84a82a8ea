//! One link's bytes: in come frames, out go frames. Pure bookkeeping; the board's tasks move the bytes.

use parfocal_protocol::frame::{DecodeError, Decoder, MAX_FRAME, encode, encode_version};
use parfocal_protocol::message::{FromBoard, Refusal, Sequence, Session, ToBoard};

/// The receiving side of a link.
#[derive(Clone, Debug, Default)]
pub struct Port {
    decoder: Decoder,
    damaged: u32,
}

/// What came out of a link's bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Received {
    /// A request.
    Request(ToBoard),
    /// A sound frame that this firmware cannot read: of another version, or with an unknown message.
    /// It is answered so that the peer can say what to flash or update: see [`encode_stranger`].
    Stranger(Option<u8>),
}

impl Port {
    /// A port that has heard nothing yet.
    pub const fn new() -> Self {
        Self { decoder: Decoder::new(), damaged: 0 }
    }

    /// Takes one byte. Damaged frames are dropped: the peer asks again.
    pub fn push(&mut self, byte: u8) -> Option<Received> {
        match self.decoder.push::<ToBoard>(byte)? {
            Ok(request) => Some(Received::Request(request)),
            Err(DecodeError::OtherVersion(version)) => Some(Received::Stranger(Some(version))),
            Err(DecodeError::UnknownMessage) => Some(Received::Stranger(None)),
            Err(DecodeError::TooLong | DecodeError::Damaged) => {
                self.damaged = self.damaged.saturating_add(1);
                None
            }
        }
    }

    /// Frames dropped because they were damaged.
    pub fn damaged(&self) -> u32 {
        self.damaged
    }
}

/// A message as one frame: the buffer and how much of it counts.
pub fn encode_message(message: &FromBoard) -> ([u8; MAX_FRAME], usize) {
    let mut buffer = [0; MAX_FRAME];
    // A frame buffer takes every message by construction; an empty frame would only make the host ask again.
    let n = encode(message, &mut buffer).unwrap_or(0);
    (buffer, n)
}

/// The answer to a [`Received::Stranger`]: the refusal `Unsupported` to nobody in particular, in this firmware's version.
pub fn encode_stranger() -> ([u8; MAX_FRAME], usize) {
    let message = FromBoard::Reply { session: Session(0), sequence: Sequence(0), result: Err(Refusal::Unsupported) };
    let mut buffer = [0; MAX_FRAME];
    let n = encode_version(parfocal_protocol::VERSION, &message, &mut buffer).unwrap_or(0);
    (buffer, n)
}
