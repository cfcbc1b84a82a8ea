//! The seven-stretch path in whole numbers alone, written apart from the planner: distance in units of 1 / (6 · D), where
//! D = tj · (tj + ta) · (2·tj + ta + tv) is the reciprocal of the jerk of a path of length 1.

use std::cmp::Ordering;

/// Durations in ticks.
#[derive(Clone, Copy, Debug)]
pub struct Exact {
    pub tj: i128,
    pub ta: i128,
    pub tv: i128,
}

/// 256 bits are enough for every product here: sign and magnitude of a · b.
fn compare_products(a: u128, b: u128, c: u128, d: u128) -> Ordering {
    fn wide(a: u128, b: u128) -> (u128, u128) {
        let (a0, a1, b0, b1) = (a & u64::MAX as u128, a >> 64, b & u64::MAX as u128, b >> 64);
        let low = a0 * b0;
        let m1 = a1 * b0 + (low >> 64);
        let m2 = a0 * b1 + (m1 & u64::MAX as u128);
        (a1 * b1 + (m1 >> 64) + (m2 >> 64), (m2 << 64) | (low & u64::MAX as u128))
    }
    wide(a, b).cmp(&wide(c, d))
}

impl Exact {
    pub fn ticks(&self) -> i128 {
        4 * self.tj + 2 * self.ta + self.tv
    }

    fn d(&self) -> i128 {
        self.tj * (self.tj + self.ta) * (2 * self.tj + self.ta + self.tv)
    }

    /// Distance at a whole tick · 6D.
    fn distance(&self, t: i128) -> i128 {
        let Exact { tj, ta, .. } = *self;
        let half = 2 * tj + ta;
        if t >= self.ticks() {
            return 6 * self.d();
        }
        if t > self.ticks() - half {
            return 6 * self.d() - self.distance(self.ticks() - t);
        }
        if t <= 0 {
            return 0;
        }
        // Jerk 1: acceleration t, speed t²/2, distance t³/6.
        if t <= tj {
            return t * t * t;
        }
        if t <= tj + ta {
            let u = t - tj;
            return tj * tj * tj + 3 * tj * tj * u + 3 * tj * u * u;
        }
        if t <= half {
            // As much below the straight line to the top speed's as the first stretch is above rest.
            let u = half - t;
            let top = tj * (tj + ta);
            return 3 * top * half - 6 * top * u + u * u * u;
        }
        let top = tj * (tj + ta);
        3 * top * half + 6 * top * (t - half)
    }

    /// Where N steps of path are at tick t against step `k` + ½: N · distance(t) / 6D <=> (2k + 1) / 2.
    pub fn at(&self, n: u32, t: i128, k: u32) -> Ordering {
        compare_products(2 * u128::from(n), self.distance(t) as u128, 2 * u128::from(k) + 1, 6 * self.d() as u128)
    }
}
