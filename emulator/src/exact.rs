//! A rest-to-rest path of constant jerk in rational arithmetic, to hold edges against: nothing of it is rounded.
//!
//! Seven stretches from rest to rest (Biagiotti & Melchiorri, *Trajectory Planning for Automatic Machines and Robots*,
//! Springer 2008, section 3.4): T1 ticks of jerk, T2 of constant acceleration, T3 of cruise. By symmetry
//! length = top·(2·T1 + T2 + T3), top = acceleration·(T1 + T2), acceleration = jerk·T1.

/// A path over `length` steps.
#[derive(Clone, Copy, Debug)]
pub struct Exact {
    /// Steps.
    pub length: u32,
    /// Ticks of jerk, of constant acceleration, of constant speed.
    pub ticks: [u64; 3],
}

/// Parts of a tick in which times are told.
pub const FINE: u64 = 64;

impl Exact {
    /// Ticks in all.
    pub fn duration(&self) -> u64 {
        let [jerk, hold, cruise] = self.ticks;
        4 * jerk + 2 * hold + cruise
    }

    /// Twice six times the distance after `fine`/[`FINE`] ticks, times [`Self::scale`]: an integer.
    fn distance(&self, fine: u64) -> i128 {
        let [t1, t2, t3] = self.ticks.map(|t| i128::from(t * FINE));
        let t = i128::from(fine);
        let total = 4 * t1 + 2 * t2 + t3;
        if 2 * t > total {
            // The second half mirrors the first.
            return i128::from(self.length) * self.scale() - self.distance((total - t) as u64);
        }
        // With jerk = 1 / (T1·(T1+T2)·(2·T1+T2+T3)) of the length: six times the distance is
        let six = if t <= t1 {
            t * t * t
        } else if t <= t1 + t2 {
            let u = t - t1;
            t1 * t1 * t1 + 3 * t1 * t1 * u + 3 * t1 * u * u
        } else if t <= 2 * t1 + t2 {
            let u = 2 * t1 + t2 - t;
            let ramp = 3 * t1 * (t1 + t2) * (2 * t1 + t2);
            ramp - 6 * t1 * (t1 + t2) * u + u * u * u
        } else {
            let u = t - 2 * t1 - t2;
            3 * t1 * (t1 + t2) * (2 * t1 + t2) + 6 * t1 * (t1 + t2) * u
        };
        2 * six * i128::from(self.length)
    }

    /// What [`Self::distance`] is multiplied by.
    fn scale(&self) -> i128 {
        let [t1, t2, t3] = self.ticks.map(|t| i128::from(t * FINE));
        12 * t1 * (t1 + t2) * (2 * t1 + t2 + t3)
    }

    /// When the path passes count `step` − ½, `step` from 1, in parts of a tick from its begin.
    pub fn edge(&self, step: u32) -> u64 {
        let target = (2 * i128::from(step) - 1) * self.scale() / 2;
        let (mut low, mut high) = (0, self.duration() * FINE);
        while low < high {
            let middle = low.midpoint(high);
            if self.distance(middle) < target { low = middle + 1 } else { high = middle }
        }
        low
    }
}

/// Greatest distance of edges from their exact times, ticks, given each one's in parts of a tick; the begin of the path, a
/// whole tick, is where it fits best.
pub fn fitted(off: impl Iterator<Item = i64>) -> f64 {
    let (low, high) = off.fold((i64::MAX, i64::MIN), |(low, high), off| (low.min(off), high.max(off)));
    if low > high {
        return 0.0;
    }
    let begin = low.midpoint(high) / FINE as i64;
    let best = (begin - 1..=begin + 1).map(|b| (high - b * FINE as i64).abs().max((low - b * FINE as i64).abs()));
    best.min().unwrap_or(0) as f64 / FINE as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_and_the_middle_are_where_symmetry_has_them() {
        for ticks in [[1000, 0, 0], [1000, 500, 0], [700, 300, 5000]] {
            let exact = Exact { length: 100, ticks };
            let (half, whole) = (exact.duration() * FINE / 2, exact.duration() * FINE);
            assert_eq!(exact.distance(0), 0);
            assert_eq!(exact.distance(half) * 2, 100 * exact.scale());
            assert_eq!(exact.distance(whole), 100 * exact.scale());
            assert_eq!(exact.edge(1) + exact.edge(100), whole + 1, "mirrored, each rounded up");
        }
    }

    #[test]
    fn the_cruise_is_even() {
        let exact = Exact { length: 1000, ticks: [840, 840, 84_000] };
        let intervals: Vec<_> = (400..600).map(|k| exact.edge(k + 1) - exact.edge(k)).collect();
        assert!(intervals.iter().max().unwrap() - intervals.iter().min().unwrap() <= 1);
    }
}
