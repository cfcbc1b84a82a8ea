//! When frames were exposed, if all that is known is when they arrived.
//!
//! A camera exposes at a steady pace; only the delivery is late, now more, now less. So the k-th frame arrives at
//! t₀ + k·T + delay, and a line t₀ + k·T that touches all arrivals from below, or from above, is the camera's own clock up to
//! a constant (Moon, Skelly and Towsley 1999 find clock skew so). It is an edge of the convex hull of the arrivals, the
//! one at their mean number. Where delays crowd towards the shortest, the lower hull is the sharper one and its
//! error falls like 1/n with the number of frames. Frames do not overtake each other, so where delays spread over several
//! frame periods hardly one is fast, and the upper hull is sharper by far. The constant is calibrated with the sweeps' latency.

use parfocal_protocol::units::HostTime;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Frames that must have come before their pace is known.
const LEAST: usize = 20;

/// Frames that are remembered: a clock that drifts is followed.
const KEPT: usize = 4096;

/// So many frames next to the hull say how well it is known.
const NEAREST: usize = 5;

/// Which side of the arrivals is the camera's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Edge {
    /// The frames that came fastest.
    #[default]
    Earliest,
    /// The frames that came last.
    Latest,
}

impl Edge {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Earliest, Self::Latest];

    fn sign(self) -> f64 {
        if self == Self::Earliest { 1.0 } else { -1.0 }
    }
}

/// From the middle of a frame's exposure to its arrival at one edge of the camera's delivery.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latency {
    /// How late, µs.
    pub late_us: f64,
    /// Time between frames when it was measured, µs: a camera set to another rate has another latency.
    pub period_us: f64,
    /// Counted to the fastest arrivals, or to the last ones.
    pub edge: Edge,
}

/// Follows the frames of one camera.
#[derive(Clone, Debug, Default)]
pub struct Pacing {
    frames: VecDeque<(u64, HostTime)>,
}

/// The camera's clock by the host's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameClock {
    number: u64,
    arrival_us: f64,
    /// Time between frames, µs.
    pub period_us: f64,
    /// How well the clock is known, µs: as far as the nearest few frames lie from it.
    pub doubt_us: f64,
}

impl Pacing {
    /// Takes in a frame's number by the camera's counter, dropped ones counted, and when it arrived. A number that does
    /// not grow means that the camera began anew: so does the pacing.
    pub fn frame(&mut self, number: u64, arrival: HostTime) {
        if self.frames.back().is_some_and(|(last, _)| number <= *last) {
            self.frames.clear();
        }
        if self.frames.len() == KEPT {
            self.frames.pop_front();
        }
        self.frames.push_back((number, arrival));
    }

    /// Frames remembered.
    pub fn frames(&self) -> usize {
        self.frames.len()
    }

    /// Number of the frame in the middle of those remembered.
    pub fn middle(&self) -> u64 {
        self.frames.get(self.frames.len() / 2).map_or(0, |(number, _)| *number)
    }

    /// Time between frames on average, µs; `None` before there are two.
    pub fn period_us(&self) -> Option<f64> {
        let ((first, began), (last, ended)) = (self.frames.front()?, self.frames.back()?);
        let frames = last.checked_sub(*first).filter(|n| *n > 0)?;
        Some((ended.0 as f64 - began.0 as f64) / frames as f64)
    }

    /// The sharper edge; `None` before enough frames have come.
    pub fn sharper(&self) -> Option<Edge> {
        let doubt = |edge| self.clock(edge).map(|clock| clock.doubt_us);
        Some(if doubt(Edge::Latest)? < doubt(Edge::Earliest)? { Edge::Latest } else { Edge::Earliest })
    }

    /// The camera's clock; `None` before enough frames have come.
    pub fn clock(&self, edge: Edge) -> Option<FrameClock> {
        if self.frames.len() < LEAST {
            return None;
        }
        let (number, start) = *self.frames.front()?;
        let sign = edge.sign();
        let points = || self.frames.iter().map(|(n, at)| ((n - number) as f64, sign * (at.0 as f64 - start.0 as f64)));
        let mean = points().map(|(x, _)| x).sum::<f64>() / self.frames.len() as f64;
        // Monotone chain: a point above the line from its predecessor to the new one is not of the lower hull.
        let mut hull: Vec<(f64, f64)> = Vec::new();
        for (x, y) in points() {
            while let [.., a, b] = hull[..]
                && (b.1 - a.1) * (x - a.0) >= (y - a.1) * (b.0 - a.0)
            {
                hull.pop();
            }
            hull.push((x, y));
        }
        let side = hull.windows(2).find(|side| side[1].0 >= mean)?;
        let slope = (side[1].1 - side[0].1) / (side[1].0 - side[0].0);
        let begin = side[0].1 - slope * side[0].0;
        let mut off: Vec<f64> = points().map(|(x, y)| y - begin - slope * x).collect();
        let (_, nearest, _) = off.select_nth_unstable_by(NEAREST + 1, f64::total_cmp);
        let (arrival_us, doubt_us) = (start.0 as f64 + sign * begin, *nearest);
        Some(FrameClock { number, arrival_us, period_us: sign * slope, doubt_us })
    }
}

impl FrameClock {
    /// When a frame would have arrived with the shortest, or the longest, delay: its exposure, up to a constant.
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

    /// Arrivals of `n` frames exposed every `period_us` from `start` on, some dropped, none overtaking another.
    fn arrivals(seed: u64, n: u64, start: f64, period_us: f64, mut delay: impl FnMut(&mut Pcg64) -> f64) -> Pacing {
        let mut random = Pcg64::seed_from_u64(seed);
        let (mut pacing, mut last) = (Pacing::default(), 0.0f64);
        for number in 0..n {
            if random.random_range(0..10) > 0 || number == 0 {
                last = last.max(start + number as f64 * period_us + delay(&mut random)) + 1.0;
                pacing.frame(number, HostTime(last as u64));
            }
        }
        pacing
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn the_sharper_edge_is_the_cameras_clock(
            seed in 0u64..1_000_000, period_us in 5_000.0f64..60_000.0, start in 0.0f64..1e7, even in any::<bool>(),
        ) {
            let delay = |random: &mut Pcg64| {
                let u: f64 = random.random();
                // Evenly late, up to many periods; or mostly fast with a long tail.
                20_000.0 + if even { 130_000.0 * u } else { -8_000.0 * (1.0 - u).ln() }
            };
            let n = 1_500;
            let pacing = arrivals(seed, n, start, period_us, delay);
            let edge = pacing.sharper().unwrap();
            let clock = pacing.clock(edge).unwrap();
            if even && period_us < 30_000.0 {
                prop_assert_eq!(edge, Edge::Latest);
            } else if !even {
                prop_assert_eq!(edge, Edge::Earliest);
            }
            prop_assert!((clock.period_us - period_us).abs() < 5.0, "{} for {period_us}", clock.period_us);
            let constant = if edge == Edge::Latest { 150_000.0 } else { 20_000.0 };
            let off = clock.time(n).0 as f64 - (start + n as f64 * period_us + constant);
            prop_assert!(off.abs() < 4_000.0 && off.abs() < 12.0 * clock.doubt_us + 50.0, "{off}, doubt {}", clock.doubt_us);
        }
    }

    #[test]
    fn steady_delivery_is_followed_to_the_microsecond() {
        let mut pacing = Pacing::default();
        for number in 0..100 {
            assert!(number >= LEAST as u64 || pacing.clock(Edge::Earliest).is_none());
            pacing.frame(number, HostTime(5_000 + number * 33_333));
        }
        for edge in Edge::ALL {
            let clock = pacing.clock(edge).unwrap();
            assert_eq!(clock.time(0), HostTime(5_000));
            assert_eq!(clock.time(1_000), HostTime(5_000 + 33_333_000));
            assert_eq!(clock.doubt_us, 0.0);
        }
        assert_eq!(pacing.period_us(), Some(33_333.0));
    }

    #[test]
    fn a_camera_that_begins_anew_is_followed_anew() {
        let mut pacing = Pacing::default();
        (0..50).for_each(|number| pacing.frame(number, HostTime(number * 10_000)));
        pacing.frame(0, HostTime(9_000_000));
        assert_eq!((pacing.clock(Edge::Earliest), pacing.frames()), (None, 1));
        (1..50).for_each(|number| pacing.frame(number, HostTime(9_000_000 + number * 20_000)));
        assert_eq!(pacing.clock(Edge::Earliest).unwrap().time(10), HostTime(9_200_000));
    }
}
