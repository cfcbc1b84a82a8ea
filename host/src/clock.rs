//! Host clock and board clock, kept in step by two-way exchanges.

use parfocal_protocol::units::{BoardTime, HostTime};

/// One exchange: when the question left, when the board had it, when it answered, when the answer came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exchange {
    /// Host clock when the question was sent.
    pub sent: HostTime,
    /// Board clock when it came in.
    pub received: BoardTime,
    /// Board clock when the answer left.
    pub answered: BoardTime,
    /// Host clock when the answer came in.
    pub returned: HostTime,
}

impl Exchange {
    /// Time spent on the way, µs, both ways together.
    fn round_trip(&self) -> i64 {
        (self.returned.0 as i64 - self.sent.0 as i64) - (self.answered.0 as i64 - self.received.0 as i64)
    }

    /// Board clock minus host clock, µs, if both ways took equally long.
    fn offset(&self) -> f64 {
        let out = self.received.0 as f64 - self.sent.0 as f64;
        let back = self.answered.0 as f64 - self.returned.0 as f64;
        (out + back) / 2.0
    }

    fn middle(&self) -> f64 {
        (self.sent.0 as f64 + self.returned.0 as f64) / 2.0
    }
}

/// Exchanges kept: enough for a drift, few enough to follow a warming crystal.
const KEPT: usize = 32;

/// What is known of the board's clock. The error is at most half of the shortest round trip seen.
#[derive(Clone, Debug, Default)]
pub struct ClockModel {
    exchanges: std::collections::VecDeque<Exchange>,
    /// (host instant, offset there, drift in µs per µs)
    line: Option<(f64, f64, f64)>,
}

/// No exchange has come back yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the clocks of host and board were never compared: ask the board for its time first")]
pub struct NeverCompared;

impl ClockModel {
    /// Takes one exchange. Slow ones (a busy bus) tell little: only those near the fastest are used.
    pub fn add(&mut self, exchange: Exchange) {
        if self.exchanges.len() == KEPT {
            self.exchanges.pop_front();
        }
        self.exchanges.push_back(exchange);
        let fastest = self.exchanges.iter().map(Exchange::round_trip).min().unwrap_or(0);
        let good: Vec<&Exchange> = self.exchanges.iter().filter(|e| e.round_trip() <= 2 * fastest + 50).collect();
        let n = good.len() as f64;
        let t0 = good.iter().map(|e| e.middle()).sum::<f64>() / n;
        let o0 = good.iter().map(|e| e.offset()).sum::<f64>() / n;
        let (mut tt, mut to) = (0.0, 0.0);
        for e in &good {
            tt += (e.middle() - t0).powi(2);
            to += (e.middle() - t0) * (e.offset() - o0);
        }
        // Crystals differ by less than 200 ppm; over a short baseline the jitter would say more than that.
        let drift = if tt > 0.0 { (to / tt).clamp(-200e-6, 200e-6) } else { 0.0 };
        let spread = good.iter().map(|e| e.middle()).fold(0.0f64, |a, t| a.max((t - t0).abs()));
        let drift = if spread > 200_000.0 { drift } else { 0.0 };
        self.line = Some((t0, o0, drift));
    }

    /// The board's time at an instant of the host's.
    ///
    /// # Errors
    /// [`NeverCompared`].
    pub fn board_time(&self, at: HostTime) -> Result<BoardTime, NeverCompared> {
        let (t0, offset, drift) = self.line.ok_or(NeverCompared)?;
        let t = at.0 as f64;
        Ok(BoardTime((t + offset + drift * (t - t0)).max(0.0).round() as u64))
    }

    /// The host's time at an instant of the board's.
    ///
    /// # Errors
    /// [`NeverCompared`].
    pub fn host_time(&self, at: BoardTime) -> Result<HostTime, NeverCompared> {
        let (t0, offset, drift) = self.line.ok_or(NeverCompared)?;
        let t = (at.0 as f64 - offset + drift * t0) / (1.0 + drift);
        Ok(HostTime(t.max(0.0).round() as u64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against the plain truth: a board clock that runs `ppm` fast, delays of up to 3 ms either way.
        #[test]
        fn the_board_clock_is_known_to_half_a_round_trip(
            ppm in -100i64..100, start in 0u64..10_000_000_000,
            delays in prop::collection::vec((100u64..3000, 100u64..3000), 8..40),
        ) {
            let board = |host: u64| (start as f64 + host as f64 * (1.0 + ppm as f64 * 1e-6)) as u64;
            let mut model = ClockModel::default();
            let mut now = 1_000_000;
            let mut fastest = u64::MAX;
            for (out, back) in delays {
                let sent = now;
                let at = sent + out;
                model.add(Exchange {
                    sent: HostTime(sent), received: BoardTime(board(at)), answered: BoardTime(board(at + 20)),
                    returned: HostTime(at + 20 + back),
                });
                fastest = fastest.min(out + back);
                now += 100_000;
            }
            let told = model.board_time(HostTime(now)).unwrap().0 as f64;
            // Extrapolated by one interval: the used exchanges are off by at most their own half round trip.
            prop_assert!((told - board(now) as f64).abs() <= (2.0 * fastest as f64 + 60.0) * 2.0, "{told} {}", board(now));
            let back = model.host_time(model.board_time(HostTime(now)).unwrap()).unwrap();
            prop_assert!(back.0.abs_diff(now) <= 1);
        }
    }

    #[test]
    fn a_clock_never_compared_is_an_error_that_says_so() {
        assert_eq!(ClockModel::default().board_time(HostTime(5)), Err(NeverCompared));
    }
}
