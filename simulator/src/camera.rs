//! When a virtual camera exposes its frames and when the host gets them. What they show is the scene's business.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// A camera's timing. It runs freely: exposures begin at whole multiples of the frame period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraTiming {
    /// From the begin of one exposure to the next, µs.
    pub period_us: u64,
    /// Length of an exposure, µs.
    pub exposure_us: u64,
    /// Shortest time from the end of an exposure to the host's having the frame, µs.
    pub latency_us: u64,
    /// Up to this much more, at random, µs.
    pub jitter_us: u64,
    /// Whether frames carry their exposure times.
    pub timestamps: bool,
}

impl Default for CameraTiming {
    /// 50 frames/s, 5 ms, a USB camera that tells exposure times.
    fn default() -> Self {
        Self { period_us: 20_000, exposure_us: 5_000, latency_us: 12_000, jitter_us: 6_000, timestamps: true }
    }
}

/// One frame's times, µs of the rig's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameTimes {
    /// Number of the frame.
    pub number: u64,
    /// Begin of its exposure.
    pub begin: u64,
    /// End of its exposure.
    pub end: u64,
    /// When the host has it.
    pub arrival: u64,
}

impl FrameTimes {
    /// The middle of the exposure.
    pub fn middle(&self) -> u64 {
        (self.begin + self.end) / 2
    }
}

/// A running camera.
#[derive(Clone, Debug)]
pub struct VirtualCamera {
    timing: CameraTiming,
    random: Pcg64,
    next: u64,
    last_arrival: u64,
}

impl VirtualCamera {
    /// A camera that has delivered nothing yet. Its latencies follow from `seed`.
    pub fn new(timing: CameraTiming, seed: u64) -> Self {
        Self { timing, random: Pcg64::seed_from_u64(seed), next: 0, last_arrival: 0 }
    }

    /// Its timing.
    pub fn timing(&self) -> CameraTiming {
        self.timing
    }

    /// The next frame that arrives after `now`: frames that came while nobody looked were dropped by its driver,
    /// all but the latest one, which waits in the driver's queue as real ones do.
    pub fn next_frame(&mut self, now: u64) -> FrameTimes {
        let mut frame = self.deliver();
        while frame.arrival + self.timing.period_us < now {
            frame = self.deliver();
        }
        frame
    }

    fn deliver(&mut self) -> FrameTimes {
        let begin = self.next * self.timing.period_us;
        let end = begin + self.timing.exposure_us;
        let jitter = if self.timing.jitter_us > 0 { self.random.random_range(0..=self.timing.jitter_us) } else { 0 };
        // Frames do not overtake each other.
        let arrival = (end + self.timing.latency_us + jitter).max(self.last_arrival + 1);
        let frame = FrameTimes { number: self.next, begin, end, arrival };
        (self.next, self.last_arrival) = (self.next + 1, arrival);
        frame
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_arrive_in_order_after_their_exposure_within_the_latency() {
        let timing = CameraTiming { jitter_us: 130_000, period_us: 33_333, ..CameraTiming::default() };
        let mut camera = VirtualCamera::new(timing, 7);
        let frames: Vec<_> = (0..200).map(|_| camera.deliver()).collect();
        assert!(frames.windows(2).all(|w| w[0].arrival < w[1].arrival && w[1].begin - w[0].begin == 33_333));
        assert!(frames.iter().all(|f| f.arrival >= f.end + 12_000));
    }

    #[test]
    fn after_a_pause_at_most_one_old_frame_is_left() {
        let mut camera = VirtualCamera::new(CameraTiming::default(), 1);
        camera.next_frame(0);
        let late = camera.next_frame(1_000_000);
        assert!(late.arrival + 20_000 >= 1_000_000);
        assert!(camera.next_frame(1_000_000).begin > late.begin);
    }
}
