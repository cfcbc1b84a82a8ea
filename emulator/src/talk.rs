//! A host's side of the protocol, for the emulated board: asks, waits, listens.

use crate::Machine;
use anyhow::{anyhow, bail};
use parfocal_protocol::frame::{Decoder, MAX_FRAME, encode};
use parfocal_protocol::message::{
    Event, FromBoard, Hello, Refusal, Request, Response, Role, Sequence, Session, Status, ToBoard,
};
use std::collections::VecDeque;
use std::time::Duration;

/// How the host is connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// USB CDC-ACM.
    Usb,
    /// USART3, through the ST-LINK.
    Serial,
}

/// How long an answer may take. The board answers within a few ms.
const PATIENCE: Duration = Duration::from_millis(200);

/// How far the board runs between two looks at the link.
const LOOK: Duration = Duration::from_micros(200);

/// The same while nothing is asked: the board moves meanwhile, and an event may wait.
const IDLE_LOOK: Duration = Duration::from_millis(1);

/// A session with the board in a [`Machine`].
pub struct Talk {
    link: Link,
    session: Session,
    sequence: u32,
    decoder: Decoder,
    /// Events not yet asked for, oldest first.
    pub events: VecDeque<Event>,
    /// Frames that came in damaged: on these links none ever should.
    pub damaged: u32,
}

impl Talk {
    /// A session with a number of its own.
    pub fn new(link: Link, session: u32) -> Self {
        Self {
            link,
            session: Session(session),
            sequence: 0,
            decoder: Decoder::new(),
            events: VecDeque::new(),
            damaged: 0,
        }
    }

    /// Says hello, asking for control.
    ///
    /// # Errors
    /// When no hello comes back.
    pub fn hello(&mut self, board: &mut Machine) -> anyhow::Result<Hello> {
        match self.ask(board, Request::Hello { role: Role::Control })? {
            Response::Hello(hello) => Ok(hello),
            other => bail!("hello was answered by {other:?}"),
        }
    }

    /// How the board is.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub fn status(&mut self, board: &mut Machine) -> anyhow::Result<Status> {
        match self.ask(board, Request::Status)? {
            Response::Status(status) => Ok(status),
            other => bail!("status was answered by {other:?}"),
        }
    }

    /// Asks, and runs the board until it has answered.
    ///
    /// # Errors
    /// When it refuses or does not answer.
    pub fn ask(&mut self, board: &mut Machine, request: Request) -> anyhow::Result<Response> {
        self.try_ask(board, request)?.map_err(|refusal| anyhow!("{request:?} was refused: {refusal:?}"))
    }

    /// As [`Self::ask`], but a refusal is an answer.
    ///
    /// # Errors
    /// When nothing comes back.
    pub fn try_ask(&mut self, board: &mut Machine, request: Request) -> anyhow::Result<Result<Response, Refusal>> {
        let sequence = self.send(board, request);
        let until = board.now() + PATIENCE;
        while board.now() < until {
            board.run_for(LOOK)?;
            if let Some(result) = self.receive(board, sequence) {
                return Ok(result);
            }
        }
        bail!("{request:?} was not answered over {:?} within {PATIENCE:?} ({} frames damaged)", self.link, self.damaged)
    }

    /// Sends a request without waiting.
    pub fn send(&mut self, board: &Machine, request: Request) -> Sequence {
        self.sequence += 1;
        let message = ToBoard { session: self.session, sequence: Sequence(self.sequence), request };
        let mut frame = [0; MAX_FRAME];
        let n = encode(&message, &mut frame).expect("a frame buffer takes every message");
        match self.link {
            Link::Usb => board.world.usb.lock().expect("turns").to_board.extend(&frame[..n]),
            Link::Serial => board.world.serial.lock().expect("turns").to_board.extend(&frame[..n]),
        }
        message.sequence
    }

    /// Reads what came in: events are kept, the answer to `sequence` comes back.
    pub fn receive(&mut self, board: &Machine, sequence: Sequence) -> Option<Result<Response, Refusal>> {
        let bytes: Vec<u8> = match self.link {
            Link::Usb => board.world.usb.lock().expect("turns").from_board.drain(..).collect(),
            Link::Serial => board.world.serial.lock().expect("turns").from_board.drain(..).collect(),
        };
        let mut answer = None;
        for byte in bytes {
            match self.decoder.push::<FromBoard>(byte) {
                Some(Ok(FromBoard::Event { event, .. })) => self.events.push_back(event),
                Some(Ok(FromBoard::Reply { session, sequence: number, result }))
                    if session == self.session && number == sequence =>
                {
                    answer = Some(result);
                }
                Some(Err(_)) => self.damaged += 1,
                Some(Ok(_)) | None => {}
            }
        }
        answer
    }

    /// Runs the board until an event comes that `wanted` takes.
    ///
    /// # Errors
    /// When none comes in time.
    pub fn until<T>(
        &mut self,
        board: &mut Machine,
        patience: Duration,
        mut wanted: impl FnMut(&Event) -> Option<T>,
    ) -> anyhow::Result<T> {
        let until = board.now() + patience;
        loop {
            while let Some(event) = self.events.pop_front() {
                if let Some(found) = wanted(&event) {
                    return Ok(found);
                }
            }
            if board.now() >= until {
                bail!("the event that was waited for did not come within {patience:?}");
            }
            board.run_for(IDLE_LOOK)?;
            self.receive(board, Sequence(0));
        }
    }
}
