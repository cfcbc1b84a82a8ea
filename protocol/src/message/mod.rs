//! Requests, replies and events.
//!
//! New variants go to the end of their enum and a changed one becomes a new one: `tests/wire.rs` pins every byte.

mod event;
mod refusal;
mod request;
mod response;

pub use event::Event;
pub use refusal::{Field, Refusal};
pub use request::{Request, Role, Stop, TriggerPlan};
pub use response::{AxisStatus, Hello, HomingFault, MotionId, ResetCause, Response, Status, StopCause, Trust};

use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A host's connection, by a number of its own choice; 0 is nobody.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema, MaxSize)]
pub struct Session(pub u32);

/// Counts a session's requests from 1. A repeated number is the same request again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, Schema, MaxSize)]
pub struct Sequence(pub u32);

/// Text of at most 16 bytes, UTF-8, padded with zeros.
#[derive(Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema, MaxSize)]
pub struct Label(pub [u8; 16]);

impl Label {
    /// The first 16 bytes of `text`, cut at a character's border.
    pub fn new(text: &str) -> Self {
        let mut end = text.len().min(16);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        let mut bytes = [0; 16];
        bytes[..end].copy_from_slice(&text.as_bytes()[..end]);
        Self(bytes)
    }

    /// The text; empty when it is not UTF-8.
    pub fn as_str(&self) -> &str {
        let end = self.0.iter().position(|b| *b == 0).unwrap_or(self.0.len());
        core::str::from_utf8(&self.0[..end]).unwrap_or("")
    }
}

impl core::fmt::Debug for Label {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

/// From host to board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub struct ToBoard {
    /// Who asks.
    pub session: Session,
    /// The number of this request.
    pub sequence: Sequence,
    /// What is asked.
    pub request: Request,
}

/// From board to host.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
#[allow(clippy::large_enum_variant, reason = "no allocation on the board: a reply is built in place")]
pub enum FromBoard {
    /// The answer to the request with this number.
    Reply {
        /// Who asked.
        session: Session,
        /// Which request.
        sequence: Sequence,
        /// What came of it.
        result: Result<Response, Refusal>,
    },
    /// Something happened.
    Event {
        /// Counts events: a gap means that one was lost, and a status tells what it said.
        count: u32,
        /// What happened.
        event: Event,
    },
}
