//! When frames were exposed, if all that is known is when they arrived.
//!
//! A camera exposes at a steady pace; only the delivery is late, now more, now less. So the k-th frame arrives at
//! t₀ + k·T + delay, the delay at least some constant: the line t₀ + k·T that runs below all arrivals and as close to them as can
//! be is the camera's own clock, up to that constant (Moon, Skelly and Towsley 1999 find clock skew so). It is an
//! edge of the lower convex hull of the arrivals, the one below their mean number, and its error falls with the number
//! of frames n like 1/n where that of the mean delay falls like 1/√n. The constant is calibrated with the
//! sweeps' latency.

use parfocal_protocol::units::HostTime;

/// Frames that must have come before their pace is known.
const LEAST: u64 = 20;

/// Follows the frames of one camera, from its start.
#[derive(Clone, Debug, Default)]
pub struct Pacing {
    /// The lower convex hull of (number, arrival in µs).
    hull: Vec<(f64, f64)>,
    origin: Option<(u64, HostTime)>,
    last: f64,
    frames: u64,
    sum: f64,
}

/// The camera's clock by the host's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameClock {
    number: u64,
    arrival_us: f64,
    /// Time between frames, µs.
    pub period_us: f64,
}

impl Pacing {
    /// Takes in a frame's number by the camera's counter, dropped ones counted, and when it arrived. A number that does
    /// not grow means that the camera began anew: so does the pacing.
    pub fn frame(&mut self, number: u64, arrival: HostTime) {
        let (first, start) = *self.origin.get_or_insert((number, arrival));
        let x = number.wrapping_sub(first) as f64;
        if number < first || (self.frames > 0 && x <= self.last) {
            *self = Self::default();
            return self.frame(number, arrival);
        }
        let y = arrival.0 as f64 - start.0 as f64;
        self.frames += 1;
        self.sum += x;
        self.last = x;
        // Monotone chain: a point above the line from its predecessor to the new one is not of the lower hull.
        while let [.., a, b] = self.hull[..]
            && (b.1 - a.1) * (x - a.0) >= (y - a.1) * (b.0 - a.0)
        {
            self.hull.pop();
        }
        self.hull.push((x, y));
    }

    /// The camera's clock; `None` before enough frames have come.
    pub fn clock(&self) -> Option<FrameClock> {
        let (number, start) = self.origin.filter(|_| self.frames >= LEAST)?;
        let mean = self.sum / self.frames as f64;
        let edge = self.hull.windows(2).find(|edge| edge[1].0 >= mean)?;
        let period_us = (edge[1].1 - edge[0].1) / (edge[1].0 - edge[0].0);
        Some(FrameClock { number, arrival_us: start.0 as f64 + edge[0].1 - period_us * edge[0].0, period_us })
    }
}

impl FrameClock {
    /// When a frame would have arrived without any delay but the shortest: its exposure, up to a constant.
    pub fn time(&self, number: u64) -> HostTime {
        let frames = number as f64 - self.number as f64;
        HostTime((self.arrival_us + frames * self.period_us).round().max(0.0) as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    proptest! {
        #[test]
        fn varying_delivery_leaves_the_pace_untouched(
            seed in 0u64..1_000_000, period_us in 5_000.0f64..60_000.0, first in 0u64..1_000, start in 0u64..10_000_000,
        ) {
            let mut random = Pcg64::seed_from_u64(seed);
            let mut pacing = Pacing::default();
            let exposed = |number: u64| start as f64 + (number - first) as f64 * period_us;
            let n = 600;
            for number in first..first + n {
                // Every tenth frame is dropped; the rest arrive 20–150 ms late.
                if random.random_range(0..10) > 0 || number == first {
                    let delay = random.random_range(20_000.0..150_000.0);
                    pacing.frame(number, HostTime((exposed(number) + delay) as u64));
                }
            }
            let clock = pacing.clock().unwrap();
            prop_assert!((clock.period_us - period_us).abs() < 15.0, "{} for {period_us}", clock.period_us);
            let late = |number| clock.time(number).0 as f64 - exposed(number) - 20_000.0;
            // In the middle the shortest delay is known to about 130 ms / n.
            prop_assert!(late(first + n / 2).abs() < 3_000.0, "{}", late(first + n / 2));
        }
    }

    #[test]
    fn steady_delivery_is_followed_to_the_microsecond() {
        let mut pacing = Pacing::default();
        for number in 0..100 {
            assert!(number >= LEAST || pacing.clock().is_none());
            pacing.frame(number, HostTime(5_000 + number * 33_333));
        }
        let clock = pacing.clock().unwrap();
        assert_eq!(clock.time(0), HostTime(5_000));
        assert_eq!(clock.time(1_000), HostTime(5_000 + 33_333_000));
    }

    #[test]
    fn a_camera_that_begins_anew_is_followed_anew() {
        let mut pacing = Pacing::default();
        (0..50).for_each(|number| pacing.frame(number, HostTime(number * 10_000)));
        pacing.frame(0, HostTime(9_000_000));
        assert_eq!(pacing.clock(), None);
        (1..50).for_each(|number| pacing.frame(number, HostTime(9_000_000 + number * 20_000)));
        assert_eq!(pacing.clock().unwrap().time(10), HostTime(9_200_000));
    }
}
