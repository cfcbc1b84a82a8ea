//! When a frame was exposed: by the camera's own word, or by its pace and a calibrated latency.

use crate::frames::camera::Stamp;
use crate::frames::pacing::{FrameClock, Latency, Pacing};
use parfocal_protocol::units::HostTime;

/// By how much a camera's period may differ from the one its latency was calibrated at.
const OTHER_PACE: f64 = 0.02;

/// Taken for a frame's delay while nothing is known: longer than any camera's queue.
const UNKNOWN_US: u64 = 300_000;

/// Why a frame has no date.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Undated {
    /// The camera does not say, and its latency was never calibrated.
    Uncalibrated,
    /// Too few frames came as yet.
    TooEarly,
    /// The camera runs at another pace than when its latency was calibrated.
    OtherPace {
        /// Time between frames then, µs.
        calibrated_us: f64,
        /// Time between frames now, µs.
        now_us: f64,
    },
}

/// Dates the frames of one camera.
#[derive(Clone, Debug, Default)]
pub struct Dating {
    pacing: Pacing,
    latency: Option<Latency>,
    told: bool,
}

impl Dating {
    /// Of a camera whose latency is known, or not.
    pub fn new(latency: Option<Latency>) -> Self {
        Self { latency, ..Self::default() }
    }

    /// Takes note of a frame; to be called with each one that comes.
    pub fn see(&mut self, stamp: &Stamp) {
        self.pacing.frame(stamp.number, stamp.arrival);
        self.told = stamp.exposure.is_some();
    }

    /// Whether the camera tells exposure times.
    pub fn told(&self) -> bool {
        self.told
    }

    /// The arrivals.
    pub fn pacing(&self) -> &Pacing {
        &self.pacing
    }

    /// The latency in force.
    pub fn latency(&self) -> Option<Latency> {
        self.latency
    }

    /// Puts a latency in force.
    pub fn set_latency(&mut self, latency: Option<Latency>) {
        self.latency = latency;
    }

    /// The middle of a frame's exposure.
    ///
    /// # Errors
    /// [`Undated`].
    pub fn middle(&self, stamp: &Stamp) -> Result<HostTime, Undated> {
        match stamp.exposure {
            Some((begin, end)) => Ok(HostTime(begin.0 + end.0.saturating_sub(begin.0) / 2)),
            None => self.paced(stamp.number).map(|(middle, _)| middle),
        }
    }

    /// The earliest instant at which a frame's exposure may have begun; without calibration a guess on the safe side.
    pub fn earliest(&self, stamp: &Stamp) -> HostTime {
        match (stamp.exposure, self.paced(stamp.number)) {
            (Some((begin, _)), _) => begin,
            // An exposure is no longer than the time between frames.
            (None, Ok((middle, clock))) => HostTime(middle.0.saturating_sub((clock.period_us / 2.0) as u64)),
            (None, Err(_)) => HostTime(stamp.arrival.0.saturating_sub(UNKNOWN_US)),
        }
    }

    /// For a camera that is known to tell nothing and was never calibrated: until when what arrives shows the world before
    /// `since`.
    pub fn stale_until(&self, since: HostTime) -> Option<HostTime> {
        let guessed = self.latency.is_none() && !self.told && self.pacing.frames() > 0;
        let period = self.pacing.period_us().unwrap_or(0.0).max(0.0) as u64;
        guessed.then(|| HostTime(since.0.saturating_add(UNKNOWN_US).saturating_sub(period)))
    }

    fn paced(&self, number: u64) -> Result<(HostTime, FrameClock), Undated> {
        let latency = self.latency.ok_or(Undated::Uncalibrated)?;
        let clock = self.pacing.clock(latency.edge).ok_or(Undated::TooEarly)?;
        let pace = clock.period_us / latency.period_us;
        if !((1.0 - OTHER_PACE)..=(1.0 + OTHER_PACE)).contains(&pace) {
            return Err(Undated::OtherPace { calibrated_us: latency.period_us, now_us: clock.period_us });
        }
        let middle = (clock.time(number).0 as f64 - latency.late_us).max(0.0);
        Ok((HostTime(middle.round() as u64), clock))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::pacing::Edge;

    fn stamp(number: u64, exposure: Option<(u64, u64)>) -> Stamp {
        let exposure = exposure.map(|(a, b)| (HostTime(a), HostTime(b)));
        Stamp { number, exposure, arrival: HostTime(40_000 + number * 10_000) }
    }

    #[test]
    fn a_cameras_own_word_goes_before_everything() {
        let dating = Dating::new(Some(Latency { late_us: 5.0, period_us: 10.0, edge: Edge::Earliest }));
        let told = stamp(3, Some((1_000, 6_000)));
        assert_eq!((dating.middle(&told), dating.earliest(&told)), (Ok(HostTime(3_500)), HostTime(1_000)));
    }

    #[test]
    fn without_a_calibration_there_is_no_date_and_only_late_frames_are_trusted() {
        let mut dating = Dating::new(None);
        (0..100).for_each(|n| dating.see(&stamp(n, None)));
        assert_eq!(dating.middle(&stamp(99, None)), Err(Undated::Uncalibrated));
        assert_eq!(dating.earliest(&stamp(99, None)), HostTime(40_000 + 990_000 - UNKNOWN_US));
    }

    #[test]
    fn with_one_the_pace_dates_a_frame_unless_it_changed() {
        let latency = Latency { late_us: 30_000.0, period_us: 10_000.0, edge: Edge::Latest };
        let mut dating = Dating::new(Some(latency));
        assert_eq!(dating.middle(&stamp(0, None)), Err(Undated::TooEarly));
        (0..100).for_each(|n| dating.see(&stamp(n, None)));
        assert_eq!(dating.middle(&stamp(99, None)), Ok(HostTime(1_000_000)));
        assert_eq!(dating.earliest(&stamp(99, None)), HostTime(995_000));
        dating.set_latency(Some(Latency { period_us: 20_000.0, ..latency }));
        let other = Undated::OtherPace { calibrated_us: 20_000.0, now_us: 10_000.0 };
        assert_eq!(dating.middle(&stamp(99, None)), Err(other));
    }
}
