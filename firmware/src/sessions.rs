//! Who talks to the board: sessions, who of them has control, and requests that come twice.

use crate::controller::Link;
use heapless::Vec;
use parfocal_protocol::message::{Refusal, Response, Role, Sequence, Session};
use parfocal_protocol::units::BoardTime;

/// Sessions remembered at once. The one silent for longest makes room, never the one in control.
const SESSIONS: usize = 4;

/// The answer to a request.
pub type Answer = Result<Response, Refusal>;

#[derive(Clone, Copy, Debug)]
struct Entry {
    session: Session,
    link: Link,
    last: Sequence,
    answer: Answer,
    heard: BoardTime,
}

/// What to do with a request, by its number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Arrival {
    /// New: carry it out.
    New,
    /// The same as the last one: give the same answer, carry nothing out.
    Again(Answer),
    /// Older than the last one: its answer is gone.
    Old,
    /// No hello from this session since the board started.
    Unknown,
}

/// The sessions of a board.
#[derive(Clone, Debug, Default)]
pub struct Sessions {
    entries: Vec<Entry, SESSIONS>,
    controller: Session,
}

impl Sessions {
    /// Nobody yet.
    pub const fn new() -> Self {
        Self { entries: Vec::new(), controller: Session(0) }
    }

    /// Looks at a request's session and number.
    pub fn arrive(&mut self, now: BoardTime, link: Link, session: Session, sequence: Sequence) -> Arrival {
        let Some(entry) = self.entries.iter_mut().find(|e| e.session == session) else { return Arrival::Unknown };
        (entry.heard, entry.link) = (now, link);
        match sequence.cmp(&entry.last) {
            core::cmp::Ordering::Greater => Arrival::New,
            core::cmp::Ordering::Equal => Arrival::Again(entry.answer),
            core::cmp::Ordering::Less => Arrival::Old,
        }
    }

    /// Opens a session, if it is not open yet, and decides its role.
    pub fn open(&mut self, now: BoardTime, link: Link, session: Session, asked: Role) -> Role {
        if !self.entries.iter().any(|e| e.session == session) {
            if self.entries.is_full() {
                let silent = (0..self.entries.len())
                    .filter(|i| self.entries[*i].session != self.controller)
                    .min_by_key(|i| self.entries[*i].heard);
                if let Some(i) = silent {
                    self.entries.swap_remove(i);
                }
            }
            let entry = Entry { session, link, last: Sequence(0), answer: Err(Refusal::NoSession), heard: now };
            // There is room: of SESSIONS entries at most one is in control.
            let _ = self.entries.push(entry);
        }
        let free = self.controller == Session(0)
            || self.controller == session
            // A port belongs to one program at a time: the one before on this link is gone.
            || self.entry(self.controller).is_none_or(|e| e.link == link);
        match asked {
            Role::Watch => {
                if self.controller == session {
                    self.controller = Session(0);
                }
                Role::Watch
            }
            Role::Control if !free => Role::Watch,
            Role::Control | Role::TakeControl => {
                self.controller = session;
                Role::Control
            }
        }
    }

    /// Keeps the answer to a request, to give it again when the request comes again.
    pub fn answered(&mut self, session: Session, sequence: Sequence, answer: Answer) {
        if let Some(entry) = self.entries.iter_mut().find(|e| e.session == session) {
            (entry.last, entry.answer) = (sequence, answer);
        }
    }

    /// Gives control back.
    pub fn release(&mut self, session: Session) {
        if self.controller == session {
            self.controller = Session(0);
        }
    }

    /// Who has control; 0 is nobody.
    pub fn controller(&self) -> Session {
        self.controller
    }

    /// When the session in control was heard last; `None` when nobody has control.
    pub fn controller_heard(&self) -> Option<BoardTime> {
        self.entry(self.controller).map(|e| e.heard)
    }

    fn entry(&self, session: Session) -> Option<&Entry> {
        self.entries.iter().find(|e| e.session == session)
    }
}
