//! Latency and backlash, told apart by sweeps.
//!
//! A frame whose time is late by τ is put where the axis is τ later: a peak swept over at speed v seems to lie v·τ further
//! on in the direction of motion. Backlash B delays the stage itself: half of it further on again, whatever the speed. So the two
//! directions of one speed differ by Δ(v) = 2·v·τ + B, and two speeds tell τ from B.

mod procedure;

pub use procedure::{Calibrated, LatencyError, LatencyPlan, measure};

use parfocal_protocol::units::{MicrometresPerSecond, Nanometres};

/// Where one peak seemed to be, swept over in both directions at one speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BothWays {
    /// Speed of the sweeps, positive.
    pub speed: MicrometresPerSecond,
    /// The peak by the sweep towards larger z.
    pub up: Nanometres,
    /// The peak by the sweep towards smaller z.
    pub down: Nanometres,
}

/// What delays a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delays {
    /// How late the frames' times are, s; negative when they are early.
    pub latency_s: f64,
    /// The way that is lost when the direction changes, µm.
    pub backlash_um: f64,
}

/// The smallest ratio of two speeds that tells latency from backlash: below it errors grow too much.
pub const LEAST_RATIO: f64 = 1.5;

impl BothWays {
    /// Δ, µm.
    fn apart(&self) -> f64 {
        self.up.micrometres().0 - self.down.micrometres().0
    }

    /// The peak itself: what delays one way delays the other as much.
    pub fn middle(&self) -> Nanometres {
        Nanometres(((i64::from(self.up.0) + i64::from(self.down.0)) / 2) as i32)
    }
}

/// Tells latency from backlash; `None` where a speed is not positive or the speeds are less than [`LEAST_RATIO`] apart.
pub fn separate(slow: &BothWays, fast: &BothWays) -> Option<Delays> {
    let (v, w) = (f64::from(slow.speed.0), f64::from(fast.speed.0));
    let apart = v > 0.0 && w.is_finite() && w >= LEAST_RATIO * v;
    apart.then(|| {
        let latency_s = (fast.apart() - slow.apart()) / (2.0 * (w - v));
        Delays { latency_s, backlash_um: slow.apart() - 2.0 * v * latency_s }
    })
}

impl Delays {
    /// Where the peak is that a sweep saw at `seen`, moving at `velocity`, signed.
    pub fn correct(&self, seen: Nanometres, velocity: MicrometresPerSecond) -> Nanometres {
        let speed = f64::from(velocity.0);
        let backlash = if speed < 0.0 { -self.backlash_um } else { self.backlash_um };
        let late_nm = (speed * self.latency_s + 0.5 * backlash) * 1000.0;
        Nanometres(seen.0.saturating_sub((if late_nm < 0.0 { late_nm - 0.5 } else { late_nm + 0.5 }) as i32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Where a sweep sees the peak: the frame at the peak is taken when the stage is there, half the backlash after the
    /// command, and dated late.
    fn seen(peak_um: f64, velocity: f64, latency_s: f64, backlash_um: f64) -> Nanometres {
        let command_when_there = peak_um + velocity.signum() * backlash_um / 2.0;
        Nanometres(((command_when_there + velocity * latency_s) * 1000.0).round() as i32)
    }

    proptest! {
        #[test]
        fn two_speeds_tell_latency_from_backlash(
            peak in -500.0f64..500.0, latency in -0.2f64..0.2, backlash in 0.0f64..20.0, v in 10.0f64..200.0, ratio in 1.6f64..5.0,
        ) {
            let both = |speed: f64| BothWays {
                speed: MicrometresPerSecond(speed as f32),
                up: seen(peak, speed, latency, backlash),
                down: seen(peak, -speed, latency, backlash),
            };
            let (slow, fast) = (both(v), both(v * ratio));
            let delays = separate(&slow, &fast).unwrap();
            prop_assert!((delays.latency_s - latency).abs() < 2e-3 / v / (ratio - 1.0));
            prop_assert!((delays.backlash_um - backlash).abs() < 0.01);
            prop_assert!((fast.middle().0 - (peak * 1000.0) as i32).abs() <= 2);
            for velocity in [v, -v * ratio] {
                let found = delays.correct(seen(peak, velocity, latency, backlash), MicrometresPerSecond(velocity as f32));
                prop_assert!((f64::from(found.0) / 1000.0 - peak).abs() < 0.02);
            }
        }

        #[test]
        fn speeds_too_alike_are_not_told_apart(v in 1.0f32..100.0, ratio in 0.1f32..1.4) {
            let both = |speed: f32| BothWays { speed: MicrometresPerSecond(speed), up: Nanometres(5), down: Nanometres(0) };
            prop_assert_eq!(separate(&both(v), &both(v * ratio)), None);
        }
    }
}
