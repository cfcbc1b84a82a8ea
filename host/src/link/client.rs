//! A blocking client: one request under way at a time.
//!
//! A request that gets no answer is sent again with the same number, which the board answers without doing it
//! again. After an unplugged cable the same holds, as long as the board has not restarted, which its boot number tells.

use super::error::LinkError;
use super::explain::reset_cause;
use super::transport::{Transport, later};
use parfocal_protocol::frame::{DecodeError, Decoder, MAX_FRAME, encode};
use parfocal_protocol::message::{
    Event, FromBoard, Hello, Refusal, Request, Response, Role, Sequence, Session, ToBoard,
};
use parfocal_protocol::units::HostTime;
use parfocal_protocol::{SCHEMA, VERSION};
use std::collections::VecDeque;

/// How patient a link is.
#[derive(Clone, Copy, Debug)]
pub struct LinkOptions {
    /// Ask again after this many ms without an answer.
    pub retry_ms: u64,
    /// Give up after this many ms.
    pub deadline_ms: u64,
    /// After an unplugged cable, wait this many ms for it to come back.
    pub reconnect_ms: u64,
}

impl Default for LinkOptions {
    fn default() -> Self {
        Self { retry_ms: 100, deadline_ms: 1500, reconnect_ms: 3000 }
    }
}

/// Events kept while nobody takes them; the oldest give way. A status tells what they said.
const EVENTS: usize = 256;

/// A session with a board.
pub struct Link {
    transport: Box<dyn Transport>,
    options: LinkOptions,
    session: Session,
    sequence: Sequence,
    hello: Hello,
    role: Role,
    decoder: Box<Decoder>,
    events: VecDeque<Event>,
    next_event: Option<u32>,
    lost_events: u32,
}

impl Link {
    /// Says hello on `transport` as session `session`, a number that no other program uses: take a random one.
    ///
    /// # Errors
    /// [`LinkError::NoAnswer`] when nothing there is a board, a version error when it is one that cannot be understood,
    /// [`LinkError::NotInControl`] when control was asked for and another program has it.
    pub fn open(
        transport: Box<dyn Transport>,
        session: Session,
        role: Role,
        options: LinkOptions,
    ) -> Result<Self, LinkError> {
        let nobody = Hello {
            schema: SCHEMA,
            firmware: [0; 3],
            git: Default::default(),
            board: Default::default(),
            unique_id: [0; 12],
            boot: 0,
            reset: parfocal_protocol::message::ResetCause::Power,
            axes: 0,
            role: Role::Watch,
            can_save: false,
            last_stop: None,
        };
        let mut link = Self {
            transport,
            options,
            session,
            sequence: Sequence(0),
            hello: nobody,
            role,
            decoder: Box::default(),
            events: VecDeque::new(),
            next_event: None,
            lost_events: 0,
        };
        link.hello = match link.ask(Request::Hello { role }) {
            Err(LinkError::Silent { port }) => Err(LinkError::NoAnswer { port }),
            other => other,
        }
        .and_then(|response| link.understood(response))?;
        if role != Role::Watch && link.hello.role != Role::Control {
            return Err(LinkError::NotInControl { port: link.port() });
        }
        Ok(link)
    }

    /// Who the board is.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// The port's name.
    pub fn port(&self) -> String {
        self.transport.name()
    }

    /// This session's number.
    pub fn session(&self) -> Session {
        self.session
    }

    /// The clock that this link's deadlines are measured by.
    pub fn now(&self) -> HostTime {
        self.transport.now()
    }

    /// How many events were lost on the way so far.
    pub fn lost_events(&self) -> u32 {
        self.lost_events
    }

    /// Asks the board for something and waits for its answer.
    ///
    /// # Errors
    /// [`LinkError::Refused`] when the board says no, others when no answer comes.
    pub fn request(&mut self, request: Request) -> Result<Response, LinkError> {
        self.ask(request)
    }

    /// The next event, waiting for one until `deadline`.
    ///
    /// # Errors
    /// [`LinkError::Unplugged`] and what follows from a restart.
    pub fn event(&mut self, deadline: HostTime) -> Result<Option<Event>, LinkError> {
        loop {
            if let Some(event) = self.events.pop_front() {
                return Ok(Some(event));
            }
            if self.transport.now() >= deadline {
                return Ok(None);
            }
            // Replies that come now are late copies of answers already given.
            self.receive(deadline, None)?;
        }
    }

    /// Ends the session: control is free for the next program at once.
    pub fn close(mut self) {
        self.options.deadline_ms = 300;
        // Whoever does not answer a goodbye is gone already.
        let _ = self.ask(Request::Goodbye);
    }

    fn understood(&self, response: Response) -> Result<Hello, LinkError> {
        let Response::Hello(hello) = response else { return Err(LinkError::OutOfTurn { port: self.port() }) };
        if hello.schema != SCHEMA {
            let [major, minor, patch] = hello.firmware;
            return Err(LinkError::OtherSchema {
                port: self.port(),
                firmware: format!("{major}.{minor}.{patch}"),
                git: hello.git.as_str().into(),
            });
        }
        Ok(hello)
    }

    fn ask(&mut self, request: Request) -> Result<Response, LinkError> {
        self.sequence.0 += 1;
        let sequence = self.sequence;
        let give_up = later(self.transport.now(), self.options.deadline_ms);
        loop {
            self.send(ToBoard { session: self.session, sequence, request })?;
            let retry = later(self.transport.now(), self.options.retry_ms).min(give_up);
            while self.transport.now() < retry {
                if let Some(result) = self.receive(retry, Some(sequence))? {
                    return self.judge(result);
                }
            }
            if self.transport.now() >= give_up {
                return Err(LinkError::Silent { port: self.port() });
            }
        }
    }

    fn judge(&self, result: Result<Response, Refusal>) -> Result<Response, LinkError> {
        result.map_err(|refusal| match refusal {
            Refusal::NotInControl { .. } => LinkError::NotInControl { port: self.port() },
            other => LinkError::Refused(other),
        })
    }

    fn send(&mut self, message: ToBoard) -> Result<(), LinkError> {
        let mut frame = [0; MAX_FRAME];
        let n = encode(&message, &mut frame).map_err(|_| LinkError::OutOfTurn { port: self.port() })?;
        match self.transport.write(&frame[..n]) {
            Ok(()) => Ok(()),
            Err(_) => self.come_back(),
        }
    }

    /// Takes bytes until a reply to `wanted` or an event has come, or `deadline` has passed.
    fn receive(
        &mut self,
        deadline: HostTime,
        wanted: Option<Sequence>,
    ) -> Result<Option<Result<Response, Refusal>>, LinkError> {
        let mut buffer = [0; 256];
        let n = match self.transport.read(&mut buffer, deadline) {
            Ok(n) => n,
            Err(_) => {
                self.come_back()?;
                0
            }
        };
        let mut answer = None;
        for byte in &buffer[..n] {
            match self.decoder.push::<FromBoard>(*byte) {
                Some(Ok(FromBoard::Reply { session, sequence, result })) => {
                    if session == self.session && Some(sequence) == wanted {
                        answer = Some(result);
                    } else if session == Session(0) && self.hello.axes == 0 {
                        // The board heard us and did not understand: another build of this protocol version.
                        return Err(self.stranger(VERSION));
                    }
                }
                Some(Ok(FromBoard::Event { count, event })) => self.happened(count, event),
                Some(Err(DecodeError::OtherVersion(version))) => return Err(self.stranger(version)),
                // Damaged frames are asked for again.
                Some(Err(_)) | None => {}
            }
        }
        Ok(answer)
    }

    fn happened(&mut self, count: u32, event: Event) {
        if let Some(expected) = self.next_event {
            self.lost_events = self.lost_events.saturating_add(count.wrapping_sub(expected).min(1 << 16));
        }
        self.next_event = Some(count.wrapping_add(1));
        if self.events.len() == EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }

    fn stranger(&self, board: u8) -> LinkError {
        let port = self.port();
        match board.cmp(&VERSION) {
            std::cmp::Ordering::Greater => LinkError::BoardNewer { port, board, host: VERSION },
            std::cmp::Ordering::Less => LinkError::BoardOlder { port, board, host: VERSION },
            std::cmp::Ordering::Equal => {
                LinkError::OtherSchema { port, firmware: "of another build".into(), git: "unknown".into() }
            }
        }
    }

    /// After the connection broke: waits for it to come back and makes sure that it is the same board, still running.
    fn come_back(&mut self) -> Result<(), LinkError> {
        let give_up = later(self.transport.now(), self.options.reconnect_ms);
        while self.transport.reconnect().is_err() {
            let now = self.transport.now();
            if now >= give_up {
                return Err(LinkError::Unplugged { port: self.port() });
            }
            // On a closed port this waits: real time passes, simulated time moves on.
            let _ = self.transport.read(&mut [0; 1], later(now, 50));
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        *self.decoder = Decoder::new();
        if self.hello.axes == 0 {
            return Ok(());
        }
        self.recognise()
    }

    /// Says hello under the number 0, which the board answers without counting it, and compares the boot number.
    fn recognise(&mut self) -> Result<(), LinkError> {
        let hello =
            ToBoard { session: self.session, sequence: Sequence(0), request: Request::Hello { role: self.role } };
        let mut frame = [0; MAX_FRAME];
        let n = encode(&hello, &mut frame).map_err(|_| LinkError::OutOfTurn { port: self.port() })?;
        let give_up = later(self.transport.now(), self.options.deadline_ms);
        while self.transport.now() < give_up {
            let gone = |port| LinkError::Unplugged { port };
            self.transport.write(&frame[..n]).map_err(|_| gone(self.transport.name()))?;
            let retry = later(self.transport.now(), self.options.retry_ms);
            while self.transport.now() < retry {
                let mut buffer = [0; 256];
                let n = self.transport.read(&mut buffer, retry).map_err(|_| gone(self.transport.name()))?;
                for byte in &buffer[..n] {
                    let Some(Ok(FromBoard::Reply { session, result: Ok(response), .. })) = self.decoder.push(*byte)
                    else {
                        continue;
                    };
                    if session != self.session || !matches!(response, Response::Hello(_)) {
                        continue;
                    }
                    let again = self.understood(response)?;
                    if again.boot != self.hello.boot || again.unique_id != self.hello.unique_id {
                        let cause = reset_cause(again.reset);
                        return Err(LinkError::Restarted { port: self.port(), cause });
                    }
                    return Ok(());
                }
            }
        }
        Err(LinkError::Silent { port: self.port() })
    }
}
