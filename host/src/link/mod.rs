//! The connection to a board: requests with deadlines, asked again when lost, never carried out twice.

mod client;
mod error;
pub mod explain;
pub mod serial;
pub mod transport;

pub use client::{Link, LinkOptions};
pub use error::LinkError;
