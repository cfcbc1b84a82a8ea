//! A thread that empties a V4L2 device's buffers as they fill.

use super::device::{self, Opened};
use super::exposure::{Monotonic, StampOf, exposure};
use super::options::V4lOptions;
use super::raw;
use crate::frames::camera::{Camera, CameraError, Frame};
use crate::frames::mailbox::{Mailbox, Outlet, STALLED};
use crate::link::transport::real_now;
use parfocal_protocol::units::HostTime;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use v4l::buffer::{Flags, Metadata};
use v4l::io::traits::CaptureStream;

/// How long a device may take for its first frame.
const START: Duration = Duration::from_secs(8);
/// So many damaged frames in a row are no accident.
const DAMAGED: u32 = 30;

/// A V4L2 device that delivers. Dropping it sets the device free.
pub struct V4lCamera {
    outlet: Outlet,
    ending: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl V4lCamera {
    /// Opens a device. `latency` is the longest time from the begin of an exposure to its frame's arrival, for a device whose
    /// buffers carry no usable times; without it such frames have none.
    ///
    /// # Errors
    /// [`CameraError::Unopened`].
    pub fn open(options: &V4lOptions, latency: Option<Duration>) -> Result<Self, CameraError> {
        let camera = options.device.display().to_string();
        let unopened = |e: device::V4lError| CameraError::Unopened { camera: camera.clone(), reason: e.to_string() };
        let opened = device::open(options).map_err(unopened)?;
        let (mailbox, ending) = (Mailbox::default(), Arc::<AtomicBool>::default());
        let outlet = Outlet::new(camera, mailbox.clone(), START);
        let end = ending.clone();
        let thread = std::thread::spawn(move || {
            let reason = read(opened, &mailbox, &end, latency);
            mailbox.end(reason);
        });
        Ok(Self { outlet, ending, thread: Some(thread) })
    }
}

/// Reads frames until none come any more, and says why.
fn read(mut opened: Opened, mailbox: &Mailbox, ending: &AtomicBool, latency: Option<Duration>) -> String {
    let clock = monotonic();
    let (mut number, mut last, mut damaged) = (0, None, 0);
    opened.stream.set_timeout(START);
    while !ending.load(Ordering::SeqCst) {
        let (bytes, about) = match opened.stream.next() {
            Ok(next) => next,
            Err(error) if error.kind() == io::ErrorKind::TimedOut => return "it delivered no more frames".into(),
            Err(error) if error.raw_os_error() == Some(rustix::io::Errno::NODEV.raw_os_error()) => {
                return "it was unplugged".into();
            }
            Err(error) => return error.to_string(),
        };
        let arrival = real_now();
        // Counted by the device: what it had to drop is missing here, too.
        number += last.map_or(0, |last| u64::from(about.sequence.wrapping_sub(last)));
        last = Some(about.sequence);
        let used = usize::try_from(about.bytesused).ok().filter(|n| *n > 0).and_then(|n| bytes.get(..n));
        let read = raw::picture(opened.layout, used.unwrap_or(bytes));
        match read {
            Ok(picture) if !about.flags.contains(Flags::ERROR) => {
                damaged = 0;
                let told = stamp(about).and_then(|(us, of)| exposure(clock.host(us), of, opened.shutter, arrival));
                let careful = latency.map(|l| HostTime(arrival.0.saturating_sub(l.as_micros() as u64)));
                let exposure = told.or(careful.map(|begin| (begin, begin)));
                mailbox.put(Frame { picture: picture.into(), number, exposure, arrival });
            }
            bad => {
                damaged += 1;
                if damaged == DAMAGED {
                    let why = bad.err().map_or("the device marks its frames as damaged".into(), |e| e.to_string());
                    return format!("{DAMAGED} damaged frames in a row: {why}; try another format or cable");
                }
            }
        }
        // Longer than a stall takes to be told.
        opened.stream.set_timeout(STALLED + Duration::from_millis(500));
    }
    "it was closed".into()
}

/// A buffer's time by the monotonic clock, µs, if it carries one.
fn stamp(about: &Metadata) -> Option<(i64, StampOf)> {
    let kind = about.flags & Flags::TIMESTAMP_MASK;
    let of = if about.flags & Flags::TSTAMP_SRC_MASK == Flags::TSTAMP_SRC_SOE { StampOf::Start } else { StampOf::End };
    let us = i64::try_from(Duration::from(about.timestamp).as_micros()).ok()?;
    (kind == Flags::TIMESTAMP_MONOTONIC).then_some((us, of))
}

/// The monotonic clock against the host's.
fn monotonic() -> Monotonic {
    let before = real_now();
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    Monotonic::new(before, now.tv_sec * 1_000_000 + now.tv_nsec / 1000, real_now())
}

impl Camera for V4lCamera {
    fn name(&self) -> String {
        self.outlet.name()
    }

    fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
        self.outlet.next_frame(deadline)
    }
}

impl Drop for V4lCamera {
    fn drop(&mut self) {
        self.ending.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has told so; the device is free either way.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_buffers_time_counts_only_by_the_monotonic_clock() {
        let about = |flags| Metadata { flags, timestamp: v4l::Timestamp::new(12, 345), ..Metadata::default() };
        let monotonic = Flags::TIMESTAMP_MONOTONIC;
        assert_eq!(stamp(&about(monotonic)), Some((12_000_345, StampOf::End)));
        assert_eq!(stamp(&about(monotonic | Flags::TSTAMP_SRC_SOE)), Some((12_000_345, StampOf::Start)));
        assert_eq!(stamp(&about(Flags::TIMESTAMP_UNKNOWN | Flags::TSTAMP_SRC_SOE)), None);
        assert_eq!(stamp(&about(Flags::TIMESTAMP_COPY)), None);
    }

    #[test]
    fn the_two_clocks_run_alike() {
        // The same constant, whenever it is asked, but for the time that asking takes.
        let (a, b) = (monotonic(), monotonic());
        assert!(a.host(10_000_000).0.abs_diff(b.host(10_000_000).0) < 1_000_000);
    }
}
