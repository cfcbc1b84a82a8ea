//! The USB host's side: enumerates the board as a computer would, then carries the serial port's bytes.

use std::collections::VecDeque;

/// A transfer that the host wants.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transfer {
    /// Reset the bus.
    Reset,
    /// A control transfer: the setup packet, and what goes out with it.
    Control {
        /// bmRequestType, bRequest, wValue, wIndex, wLength.
        setup: [u8; 8],
        /// Data towards the device.
        out: Vec<u8>,
    },
}

/// What a transaction came to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Handshake {
    /// Accepted; the data of an IN transaction.
    Ack(Vec<u8>),
    /// Not now.
    Nak,
    /// Never.
    Stall,
}

/// The stages of a control transfer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stage {
    /// The setup packet is next.
    #[default]
    Setup,
    /// Data is moving.
    Data,
    /// The empty packet that ends it.
    Status,
}

/// The host.
#[derive(Debug, Default)]
pub struct Host {
    /// Control transfers still to be made, in order.
    pub transfers: VecDeque<Transfer>,
    /// What control transfers brought back; `None` for a stall.
    pub answers: Vec<Option<Vec<u8>>>,
    /// Whether the cable is in.
    pub attached: bool,
    /// Bytes for the serial port.
    pub to_board: VecDeque<u8>,
    /// Bytes from the serial port.
    pub from_board: VecDeque<u8>,
    /// Stage of the control transfer under way.
    pub stage: Stage,
    /// Bytes of its data stage sent.
    pub sent: usize,
    /// Bytes of its data stage received.
    pub received: Vec<u8>,
    /// Turns between OUT and IN on the data endpoints.
    pub turn: bool,
}

/// The serial port's data endpoints, as embassy-usb numbers them.
pub const DATA_OUT: usize = 1;
/// See [`DATA_OUT`].
pub const DATA_IN: usize = 2;

impl Host {
    /// Plugs the cable in and enumerates: descriptors, address 5, configuration 1, 115,200 Bd 8N1, DTR and RTS.
    pub fn plug_in(&mut self) {
        self.attached = true;
        let mut control = |setup, out: &[u8]| self.transfers.push_back(Transfer::Control { setup, out: out.to_vec() });
        control([0x80, 6, 0, 1, 0, 0, 18, 0], &[]);
        control([0, 5, 5, 0, 0, 0, 0, 0], &[]);
        control([0x80, 6, 0, 2, 0, 0, 255, 0], &[]);
        control([0, 9, 1, 0, 0, 0, 0, 0], &[]);
        control([0x21, 0x20, 0, 0, 0, 0, 7, 0], &[0, 0xc2, 1, 0, 0, 0, 8]);
        control([0x21, 0x22, 3, 0, 0, 0, 0, 0], &[]);
        self.transfers.push_front(Transfer::Reset);
    }

    /// Whether enumeration is over and the serial port open.
    pub fn is_open(&self) -> bool {
        self.attached && self.transfers.is_empty()
    }

    /// Ends the transfer under way.
    pub fn end(&mut self, answer: Option<Vec<u8>>) {
        self.transfers.pop_front();
        self.answers.push(answer);
        (self.stage, self.sent) = (Stage::Setup, 0);
        self.received.clear();
    }

    /// The next packet for the serial port, left in the queue until the board takes it.
    pub fn packet(&self) -> Vec<u8> {
        self.to_board.iter().copied().take(64).collect()
    }
}
