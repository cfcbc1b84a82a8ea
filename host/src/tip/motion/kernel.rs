//! How a point out of focus is spread: between these two lie real objectives.

use std::f64::consts::PI;
use std::sync::LazyLock;

/// A blurred edge, tabulated over its distance in standard deviations of the blur.
pub struct Kernel {
    table: [f32; STEPS + 2],
}

const STEPS: usize = 1024;
const SUPPORT: f32 = 4.0;

impl Kernel {
    /// A Gaussian (an apodised aperture), and a disc of the same variance (geometric optics with a full aperture).
    pub fn both() -> [&'static Self; 2] {
        static BOTH: LazyLock<[Kernel; 2]> = LazyLock::new(|| [Kernel::of(normal_below), Kernel::of(disc_below)]);
        [&BOTH[0], &BOTH[1]]
    }

    fn of(below: fn(f64) -> f64) -> Self {
        let mut table = [1.0; STEPS + 2];
        for (i, value) in table.iter_mut().enumerate().take(STEPS) {
            *value = below(f64::from(SUPPORT) * (2.0 * i as f64 / STEPS as f64 - 1.0)) as f32;
        }
        // Flat from its ends on: a last tread would have a slope that everything beyond it seems to have.
        (table[0], table[1]) = (0.0, 0.0);
        Self { table }
    }

    /// The edge's light at `x`, and its slope there.
    #[inline(always)]
    pub fn step(&self, x: f32) -> (f32, f32) {
        let scale = STEPS as f32 / (2.0 * SUPPORT);
        let u = ((x + SUPPORT) * scale).clamp(0.0, STEPS as f32);
        let i = u as usize;
        let (low, high) = (self.table[i], self.table[i + 1]);
        (low + (u - i as f32) * (high - low), (high - low) * scale)
    }
}

/// The share of a standard normal distribution below `x`, by its power series (Marsaglia 2004).
fn normal_below(x: f64) -> f64 {
    let (mut term, mut sum, mut n) = (x, x, 1.0);
    while term.abs() > 1e-15 {
        n += 2.0;
        term *= x * x / n;
        sum += term;
    }
    0.5 + sum * (-0.5 * x * x).exp() / (2.0 * PI).sqrt()
}

/// The share of a disc below `x` standard deviations from its middle: a standard deviation is half its radius.
fn disc_below(x: f64) -> f64 {
    let u = (0.5 * x).clamp(-1.0, 1.0);
    0.5 + (u * (1.0 - u * u).sqrt() + u.asin()) / PI
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_have_the_same_variance_and_their_slopes_are_their_own() {
        for kernel in Kernel::both() {
            let d = 0.01_f32;
            let places = || (-450..=450).map(|k| k as f32 * d);
            let variance: f32 = places().map(|x| x * x * kernel.step(x).1 * d).sum();
            assert!((variance - 1.0).abs() < 0.01, "{variance}");
            for x in places() {
                let difference = (kernel.step(x + d).0 - kernel.step(x - d).0) / (2.0 * d);
                assert!((difference - kernel.step(x).1).abs() < 0.03, "{x}");
            }
        }
    }
}
