//! What a Parfocal board and its host say to each other: units, messages and framing. No allocation, no `std`.
//!
//! A frame is `COBS(version byte, postcard message, CRC-32) 0x00`. The version byte and the CRC stand where they stand
//! in every version of the protocol, so two programs of different versions can tell why they do not understand
//! each other.
#![no_std]

pub mod autofocus;
pub mod frame;
pub mod message;
pub mod settings;
pub mod units;

/// Version of the protocol: the first byte of every frame. Raised when an old peer could misread a message.
pub const VERSION: u8 = 1;

/// A fingerprint of every message type: equal exactly when both sides were built from the same definitions.
pub const SCHEMA: [u8; 8] =
    postcard_schema::key::Key::for_path::<(message::ToBoard, message::FromBoard)>("parfocal").to_bytes();
