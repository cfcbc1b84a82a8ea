//! The camera's frames for everyone: one thread reads them, the page looks at the latest, a scan gets each of the next.

use crate::frames::camera::{Camera, CameraError, Frame};
use crate::link::transport::{later, real_now};
use parfocal_protocol::units::HostTime;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;

/// Frames kept for who is a little late.
const KEPT: usize = 4;
/// How often the thread looks whether it shall do something else, ms.
const LOOK_MS: u64 = 100;

/// Opens the camera; called again for every restart.
pub type Open = Box<dyn FnMut() -> Result<Box<dyn Camera>, CameraError> + Send>;

/// How the camera is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Health {
    /// Opened, no frame yet.
    Starting,
    /// Frames come.
    Running,
    /// It ended, stalled, or changed its frames: why, and what to do.
    Failed(String),
}

/// The camera's frames, shared.
#[derive(Clone)]
pub struct Feed(Arc<Shared>);

struct Shared {
    inside: Mutex<Inside>,
    news: Condvar,
    count: watch::Sender<u64>,
}

struct Inside {
    frames: VecDeque<(u64, Arc<Frame>)>,
    count: u64,
    health: Health,
    restart: bool,
    end: bool,
    /// Mean time between frames, s.
    period_s: f64,
    last: HostTime,
}

impl Feed {
    /// Starts the thread that reads the camera.
    pub fn start(open: Open) -> Self {
        let inside = Inside {
            frames: VecDeque::new(),
            count: 0,
            health: Health::Starting,
            restart: false,
            end: false,
            period_s: 0.0,
            last: HostTime(0),
        };
        let shared = Shared { inside: Mutex::new(inside), news: Condvar::new(), count: watch::Sender::new(0) };
        let feed = Self(Arc::new(shared));
        let own = feed.clone();
        std::thread::spawn(move || own.run(open));
        feed
    }

    fn lock(&self) -> MutexGuard<'_, Inside> {
        // Whole at any time.
        self.0.inside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self, mut open: Open) {
        while !self.lock().end {
            let failure = match open() {
                Ok(camera) => self.read(camera),
                Err(error) => Some(error.to_string()),
            };
            let mut inside = self.lock();
            if let Some(failure) = failure {
                inside.health = Health::Failed(failure);
                self.0.news.notify_all();
                // The page's clients learn of it with the next state.
            }
            while !inside.restart && !inside.end {
                inside = self.0.news.wait(inside).unwrap_or_else(PoisonError::into_inner);
            }
            inside.restart = false;
            inside.health = Health::Starting;
            inside.frames.clear();
        }
    }

    /// Reads until the camera fails, and says why; `None` when it shall be opened anew.
    fn read(&self, mut camera: Box<dyn Camera>) -> Option<String> {
        loop {
            let next = camera.next_frame(later(real_now(), LOOK_MS));
            let mut inside = self.lock();
            if inside.restart || inside.end {
                return None;
            }
            match next {
                Ok(None) => {}
                Err(error) => return Some(error.to_string()),
                Ok(Some(frame)) => {
                    let gap = frame.arrival.0.saturating_sub(inside.last.0) as f64 * 1e-6;
                    inside.period_s =
                        if inside.period_s == 0.0 { gap.min(1.0) } else { 0.9 * inside.period_s + 0.1 * gap };
                    inside.last = frame.arrival;
                    inside.count += 1;
                    inside.health = Health::Running;
                    let old = if inside.frames.len() == KEPT { inside.frames.pop_front() } else { None };
                    let count = inside.count;
                    inside.frames.push_back((count, Arc::new(frame)));
                    drop(inside);
                    // A scan that waits goes first; then the page, then a frame's memory is given back.
                    self.0.news.notify_all();
                    self.0.count.send_replace(count);
                    drop(old);
                }
            }
        }
    }

    /// The latest frame and its number in this feed.
    pub fn latest(&self) -> Option<(u64, Arc<Frame>)> {
        self.lock().frames.back().cloned()
    }

    /// Tells of new frames: the number of the latest.
    pub fn count(&self) -> watch::Receiver<u64> {
        self.0.count.subscribe()
    }

    /// How the camera is, and its frames a second.
    pub fn health(&self) -> (Health, f64) {
        let inside = self.lock();
        let rate = if inside.period_s > 0.0 { 1.0 / inside.period_s } else { 0.0 };
        (inside.health.clone(), rate)
    }

    /// Closes the camera and opens it anew.
    pub fn restart(&self) {
        self.lock().restart = true;
        self.0.news.notify_all();
    }

    /// Ends the thread.
    pub fn end(&self) {
        self.lock().end = true;
        self.0.news.notify_all();
    }

    /// A camera that delivers this feed's frames from now on. `keep_on` is asked while it waits; false: no more frames.
    pub fn camera(&self, keep_on: Arc<dyn Fn() -> bool + Send + Sync>) -> FeedCamera {
        FeedCamera { seen: self.lock().count, feed: self.clone(), keep_on, arrival: Arc::default() }
    }
}

/// The feed as a camera of its own.
pub struct FeedCamera {
    feed: Feed,
    seen: u64,
    keep_on: Arc<dyn Fn() -> bool + Send + Sync>,
    arrival: Arc<AtomicU64>,
}

impl FeedCamera {
    /// When the frame that was given last had arrived, µs of the host's clock; shared, for who has lent the camera away.
    pub fn arrival(&self) -> Arc<AtomicU64> {
        self.arrival.clone()
    }
}

impl Camera for FeedCamera {
    fn name(&self) -> String {
        "of the page".into()
    }

    fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
        let mut inside = self.feed.lock();
        loop {
            if let Some((number, frame)) = inside.frames.iter().find(|(number, _)| *number > self.seen).cloned() {
                drop(inside);
                self.seen = number;
                self.arrival.store(frame.arrival.0, Ordering::Relaxed);
                return Ok(Some(Frame::clone(&frame)));
            }
            if let Health::Failed(reason) = &inside.health {
                return Err(CameraError::Ended { camera: self.name(), reason: reason.clone() });
            }
            let now = real_now();
            if now >= deadline || !(self.keep_on)() {
                return Ok(None);
            }
            let wait = Duration::from_micros(deadline.0 - now.0).min(Duration::from_millis(20));
            inside = self.feed.0.news.wait_timeout(inside, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Picture;
    use std::sync::atomic::AtomicU32;

    /// Gives three frames, then fails.
    struct Short(u64);

    impl Camera for Short {
        fn name(&self) -> String {
            "short".into()
        }

        fn next_frame(&mut self, _deadline: HostTime) -> Result<Option<Frame>, CameraError> {
            self.0 += 1;
            if self.0 > 3 {
                return Err(CameraError::Ended { camera: self.name(), reason: "out of film".into() });
            }
            let picture = Picture::grey8(1, 1, vec![self.0 as u8]).unwrap();
            Ok(Some(Frame { picture: picture.into(), number: self.0, exposure: None, arrival: real_now() }))
        }
    }

    #[test]
    fn a_camera_that_fails_is_told_and_opened_again_on_request() {
        let opened = Arc::new(AtomicU32::new(0));
        let count = opened.clone();
        let feed = Feed::start(Box::new(move || {
            count.fetch_add(1, Ordering::SeqCst);
            Ok(Box::new(Short(0)))
        }));
        let failed = |feed: &Feed| {
            while !matches!(feed.health().0, Health::Failed(ref why) if why.contains("out of film")) {
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        failed(&feed);
        assert_eq!(feed.latest().unwrap().1.number, 3);
        let mut camera = feed.camera(Arc::new(|| true));
        assert!(camera.next_frame(later(real_now(), 100)).is_err());
        feed.restart();
        while opened.load(Ordering::SeqCst) < 2 {
            std::thread::sleep(Duration::from_millis(1));
        }
        failed(&feed);
        feed.end();
    }
}
