//! The far end of USART3: what the ST-LINK's virtual serial port is on the desk.

use rigless::chip::Timeline;
use rigless::chip::uart::Peer;
use rigless::snapshot::Store;
use rigless::time::VirtualNanos;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

/// Bytes on their way.
#[derive(Debug, Default)]
pub struct Line {
    /// To the board, sent back to back at the line's speed.
    pub to_board: VecDeque<u8>,
    /// From the board, oldest first.
    pub from_board: VecDeque<u8>,
}

/// The end that hangs on the emulated USART.
#[derive(Debug)]
pub struct FarEnd(pub Arc<Mutex<Line>>);

/// Runs are not stopped and stored.
impl Store for FarEnd {}

impl Peer for FarEnd {
    fn receive(&mut self, word: u16, _: &mut Timeline<'_, '_>) {
        self.0.lock().expect("one thread at a time").from_board.push_back(word as u8);
    }

    fn transmit(&mut self, _: VirtualNanos) -> Option<u16> {
        self.0.lock().expect("one thread at a time").to_board.pop_front().map(u16::from)
    }
}
