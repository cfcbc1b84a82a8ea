//! When a V4L2 device's frame was exposed, by the host's clock.
//!
//! A buffer carries one time: of the monotonic clock, taken when the exposure of the frame started, or when its last pixel had come
//! (V4L2_BUF_FLAG_TSTAMP_SRC_SOE and _EOF, <https://docs.kernel.org/userspace-api/media/v4l/buffer.html>). Rows are exposed one after
//! the other by a rolling shutter: the frame's exposure is that of all its rows, and its middle that of the middle row.

use parfocal_protocol::units::HostTime;

/// What a buffer's time stamp is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampOf {
    /// The start of the exposure.
    Start,
    /// The arrival of the last pixel.
    End,
}

/// The monotonic clock against the host's clock of this program. Both run alike: they differ by a constant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Monotonic {
    /// What the monotonic clock is ahead, µs.
    ahead_us: i64,
}

impl Monotonic {
    /// From one look at the monotonic clock between two at the host's.
    pub fn new(before: HostTime, monotonic_us: i64, after: HostTime) -> Self {
        let host = before.0 as i64 + (after.0 as i64 - before.0 as i64) / 2;
        Self { ahead_us: monotonic_us - host }
    }

    /// A time of the monotonic clock by the host's; one from before the host's clock began is its beginning.
    pub fn host(&self, monotonic_us: i64) -> HostTime {
        HostTime(monotonic_us.saturating_sub(self.ahead_us).max(0) as u64)
    }
}

/// How long a frame takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shutter {
    /// Each row's exposure, µs.
    pub exposure_us: u64,
    /// From the first row to the last, µs; 0 for a global shutter.
    pub readout_us: u64,
}

/// Stamps later than the arrival, or this much earlier, are no stamps: some devices count from another beginning, µs.
const BELIEVED_US: u64 = 2_000_000;
/// By so much a stamp may seem to lie behind the arrival: it was rounded, µs.
const ROUNDED_US: u64 = 1_000;

/// Begin and end of a frame's exposure; `None` when the stamp cannot be believed.
pub fn exposure(stamp: HostTime, of: StampOf, shutter: Shutter, arrival: HostTime) -> Option<(HostTime, HostTime)> {
    if stamp.0 > arrival.0 + ROUNDED_US || stamp.0 + BELIEVED_US < arrival.0 {
        return None;
    }
    let long = shutter.exposure_us + shutter.readout_us;
    Some(match of {
        // No frame comes before its exposure has ended, however long a device says it exposes.
        StampOf::Start => (stamp, HostTime((stamp.0 + long).min(arrival.0.max(stamp.0)))),
        StampOf::End => (HostTime(stamp.0.saturating_sub(long)), stamp),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHUTTER: Shutter = Shutter { exposure_us: 5_000, readout_us: 20_000 };

    #[test]
    fn the_monotonic_clock_is_the_hosts_shifted() {
        // Asked between 100 and 110 µs of the host's clock.
        let clock = Monotonic::new(HostTime(100), 7_000_105, HostTime(110));
        assert_eq!(clock.host(7_000_105), HostTime(105));
        assert_eq!(clock.host(8_000_000), HostTime(1_000_000));
        assert_eq!(clock.host(6_000_000), HostTime(0), "from before this program");
        assert_eq!(clock.host(i64::MIN), HostTime(0));
        let behind = Monotonic::new(HostTime(5_000_000), 10, HostTime(5_000_000));
        assert_eq!(behind.host(20), HostTime(5_000_010));
    }

    #[test]
    fn a_stamp_of_either_end_gives_both() {
        let at = |us| HostTime(us);
        let start = exposure(at(100_000), StampOf::Start, SHUTTER, at(140_000));
        assert_eq!(start, Some((at(100_000), at(125_000))));
        let end = exposure(at(130_000), StampOf::End, SHUTTER, at(140_000));
        assert_eq!(end, Some((at(105_000), at(130_000))));
        // A row's exposure in the middle of the frame, by hand: it ends when half the rows are read.
        let (begin, end) = end.unwrap();
        assert_eq!((begin.0 + end.0) / 2, 130_000 - 10_000 - 2_500);
    }

    #[test]
    fn an_exposure_ends_before_its_frame_comes() {
        let shutter = Shutter { exposure_us: 90_000, readout_us: 20_000 };
        let told = exposure(HostTime(100_000), StampOf::Start, shutter, HostTime(140_000));
        assert_eq!(told, Some((HostTime(100_000), HostTime(140_000))));
        assert_eq!(
            exposure(HostTime(10), StampOf::End, shutter, HostTime(10)),
            Some((HostTime(0), HostTime(10))),
            "not before the clock's beginning"
        );
    }

    #[test]
    fn stamps_of_another_clock_are_not_believed() {
        for (stamp, arrival) in [(150_000, 140_000), (0, 140_000_000), (u64::MAX / 2, 5)] {
            assert_eq!(
                exposure(HostTime(stamp), StampOf::Start, SHUTTER, HostTime(arrival)),
                None,
                "{stamp} {arrival}"
            );
        }
        assert!(exposure(HostTime(140_900), StampOf::End, SHUTTER, HostTime(140_000)).is_some(), "rounded");
    }
}
