//! A board's connection as the page shares it: the link that drives the board, and beside it a watcher that always knows how
//! the board is and can always stop it, whatever the link is in the middle of.
//!
//! The watcher is a session of its own on the same wire ([`Role::Watch`]): it asks for the status twenty times a second while
//! the link waits for something, listens to every answer that passes, and may send STOP, which a board obeys from anyone.

use crate::link::transport::{Transport, later, real_now};
use parfocal_protocol::frame::{Decoder, MAX_FRAME, encode};
use parfocal_protocol::message::{
    FromBoard, Refusal, Request, Response, Role, Sequence, Session, Status, Stop, ToBoard,
};
use parfocal_protocol::units::HostTime;
use std::io;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How often the board is asked how it is, ms.
const ASK_MS: u64 = 50;
/// How long the wire is held for one read, ms: a STOP waits for no longer.
const SLICE_MS: u64 = 2;
/// A STOP without an answer is sent again after this, ms.
const AGAIN_MS: u64 = 30;

/// How a board was when it was heard last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heard {
    /// What it said.
    pub status: Status,
    /// When.
    pub at: HostTime,
}

/// The watcher's end: one for each board, shared by everyone who wants to look or to stop.
#[derive(Clone)]
pub struct Watcher(Arc<Shared>);

/// The link's end.
pub struct Line {
    shared: Arc<Shared>,
    decoder: Box<Decoder>,
    ask: HostTime,
}

struct Shared {
    wire: Mutex<Box<dyn Transport>>,
    /// Who waits for the wire to send a STOP.
    waiting: AtomicU32,
    session: Session,
    sequence: AtomicU32,
    heard: Mutex<Option<Heard>>,
    stop: Mutex<Option<Pending>>,
}

/// A STOP that the board has not answered yet.
#[derive(Clone, Copy)]
struct Pending {
    sequence: Sequence,
    how: Stop,
    sent: HostTime,
}

fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // What is behind these locks is whole at any time.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Line {
    /// Shares a wire; the watcher is `session`, a number that nobody else uses. The transport's clock must be
    /// this computer's ([`real_now`]).
    pub fn new(transport: Box<dyn Transport>, session: Session) -> Self {
        let shared = Shared {
            wire: Mutex::new(transport),
            waiting: AtomicU32::new(0),
            session,
            sequence: AtomicU32::new(0),
            heard: Mutex::new(None),
            stop: Mutex::new(None),
        };
        let line = Self { shared: Arc::new(shared), decoder: Box::default(), ask: HostTime(0) };
        // A wire that is broken already says so at the link's first request.
        let _ = line.hello();
        line
    }

    /// The watcher's end.
    pub fn watcher(&self) -> Watcher {
        Watcher(self.shared.clone())
    }

    /// Number 0: answered without counting, as often as it is sent.
    fn hello(&self) -> io::Result<()> {
        self.shared.send(Sequence(0), Request::Hello { role: Role::Watch })
    }

    fn listen(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let Some(Ok(FromBoard::Reply { session, sequence, result })) = self.decoder.push::<FromBoard>(*byte) else {
                continue;
            };
            if session == self.shared.session {
                let mut stop = lock(&self.shared.stop);
                if stop.is_some_and(|pending| pending.sequence == sequence) {
                    *stop = None;
                }
            }
            match result {
                Ok(Response::Status(status)) => *lock(&self.shared.heard) = Some(Heard { status, at: real_now() }),
                // It restarted, or others took the watcher's place among its sessions.
                Err(Refusal::NoSession) if session == self.shared.session => drop(self.hello()),
                _ => {}
            }
        }
    }

    /// What is due now besides the link's own traffic.
    fn tend(&mut self) -> io::Result<()> {
        let now = real_now();
        let again = *lock(&self.shared.stop);
        if let Some(pending) = again
            && now >= later(pending.sent, AGAIN_MS)
        {
            self.shared.send_stop(pending.how)?;
        }
        if now >= self.ask {
            self.ask = later(now, ASK_MS);
            let sequence = self.shared.next();
            self.shared.send(sequence, Request::Status)?;
        }
        Ok(())
    }
}

impl Transport for Line {
    fn name(&self) -> String {
        lock(&self.shared.wire).name()
    }

    fn read(&mut self, buffer: &mut [u8], deadline: HostTime) -> io::Result<usize> {
        loop {
            while self.shared.waiting.load(Ordering::SeqCst) > 0 {
                std::thread::sleep(Duration::from_micros(50));
            }
            let slice = deadline.min(later(real_now(), SLICE_MS));
            let n = lock(&self.shared.wire).read(buffer, slice)?;
            if n > 0 {
                self.listen(&buffer[..n]);
            }
            self.tend()?;
            if n > 0 || real_now() >= deadline {
                return Ok(n);
            }
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        lock(&self.shared.wire).write(bytes)
    }

    fn now(&self) -> HostTime {
        real_now()
    }

    fn reconnect(&mut self) -> io::Result<()> {
        *lock(&self.shared.heard) = None;
        lock(&self.shared.wire).reconnect()?;
        *self.decoder = Decoder::new();
        self.hello()
    }
}

impl Shared {
    fn next(&self) -> Sequence {
        Sequence(self.sequence.fetch_add(1, Ordering::SeqCst) + 1)
    }

    fn send(&self, sequence: Sequence, request: Request) -> io::Result<()> {
        let mut frame = [0; MAX_FRAME];
        let message = ToBoard { session: self.session, sequence, request };
        let n = encode(&message, &mut frame).map_err(|_| io::Error::from(io::ErrorKind::InvalidData))?;
        self.waiting.fetch_add(1, Ordering::SeqCst);
        let mut wire = lock(&self.wire);
        self.waiting.fetch_sub(1, Ordering::SeqCst);
        wire.write(&frame[..n])
    }

    fn send_stop(&self, how: Stop) -> io::Result<()> {
        let sequence = self.next();
        *lock(&self.stop) = Some(Pending { sequence, how, sent: real_now() });
        self.send(sequence, Request::Stop { how })
    }
}

impl Watcher {
    /// Stops the board, now. Sent again until the board has answered.
    ///
    /// # Errors
    /// The wire is gone: the board stops by itself, for it hears nothing.
    pub fn stop(&self, how: Stop) -> io::Result<()> {
        self.0.send_stop(how)
    }

    /// How the board was when it was heard last.
    pub fn heard(&self) -> Option<Heard> {
        *lock(&self.0.heard)
    }
}
