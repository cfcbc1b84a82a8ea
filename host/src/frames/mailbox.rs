//! Between the thread that reads a camera and who takes its frames: a few frames wait, the oldest give way, so that nothing queues up.

use super::camera::{CameraError, Frame};
use crate::link::transport::real_now;
use parfocal_protocol::units::HostTime;
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Frames that wait for who is a little late.
const KEPT: usize = 4;
/// A camera silent for this long has stalled.
pub const STALLED: Duration = Duration::from_millis(1500);

/// The reading thread's end.
#[derive(Clone, Default)]
pub struct Mailbox(Arc<Shared>);

#[derive(Default)]
struct Shared {
    inside: Mutex<Inside>,
    news: Condvar,
}

#[derive(Default)]
struct Inside {
    frames: VecDeque<Frame>,
    /// Why no more come.
    end: Option<String>,
}

impl Mailbox {
    fn lock(&self) -> MutexGuard<'_, Inside> {
        // Nothing in here can be left half done.
        self.0.inside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A new frame.
    pub fn put(&self, frame: Frame) {
        let mut inside = self.lock();
        if inside.frames.len() == KEPT {
            inside.frames.pop_front();
        }
        inside.frames.push_back(frame);
        self.0.news.notify_all();
    }

    /// No more come, and why.
    pub fn end(&self, reason: String) {
        self.lock().end = Some(reason);
        self.0.news.notify_all();
    }
}

/// The end of who takes the frames. It tells a stall, an end, and frames that change their size.
pub struct Outlet {
    name: String,
    mailbox: Mailbox,
    /// How long the first frame may take.
    start: Duration,
    size: Option<(usize, usize)>,
    heard: HostTime,
}

impl Outlet {
    /// The outlet of a camera called `name`, whose first frame may take as long as `start`.
    pub fn new(name: String, mailbox: Mailbox, start: Duration) -> Self {
        Self { name, mailbox, start, size: None, heard: real_now() }
    }

    /// What the camera is called in messages.
    pub fn name(&self) -> String {
        self.name.clone()
    }

    /// As [`super::camera::Camera::next_frame`].
    ///
    /// # Errors
    /// [`CameraError`]: it ended, stalled, or changed its frames.
    pub fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
        let mailbox = self.mailbox.clone();
        let mut inside = mailbox.lock();
        loop {
            if let Some(frame) = inside.frames.pop_front() {
                drop(inside);
                return self.accept(frame).map(Some);
            }
            if let Some(reason) = &inside.end {
                return Err(CameraError::Ended { camera: self.name(), reason: reason.clone() });
            }
            let now = real_now();
            let silent = Duration::from_micros(now.0.saturating_sub(self.heard.0));
            if silent >= if self.size.is_some() { STALLED } else { self.start } {
                return Err(CameraError::Stalled { camera: self.name(), millis: silent.as_millis() as u64 });
            }
            if now >= deadline {
                return Ok(None);
            }
            let wait = Duration::from_micros(deadline.0 - now.0).min(Duration::from_millis(100));
            inside = mailbox.0.news.wait_timeout(inside, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Number of the latest frame that waits.
    #[cfg(test)]
    pub fn latest(&self) -> Option<u64> {
        self.mailbox.lock().frames.back().map(|frame| frame.number)
    }

    fn accept(&mut self, frame: Frame) -> Result<Frame, CameraError> {
        let size = (frame.picture.width, frame.picture.height);
        self.heard = frame.arrival;
        let first = *self.size.get_or_insert(size);
        if first == size {
            return Ok(frame);
        }
        let text = |(width, height): (usize, usize)| format!("{width}x{height}");
        Err(CameraError::Resized { camera: self.name(), from: text(first), to: text(size) })
    }
}
