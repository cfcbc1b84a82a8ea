//! Numbers that carry their derivatives along (forward differentiation).

use std::ops::{Add, Mul, Sub};

/// Derivatives that a [`Dual`] carries: they fill a register.
pub const LANES: usize = 4;

/// A value and its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Dual {
    pub value: f32,
    pub slopes: [f32; LANES],
}

/// What the model computes with: plain values, or values with derivatives.
pub trait Number: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    fn constant(value: f32) -> Self;
    fn value(self) -> f32;
    /// A function of this number, given that function's value and slope here.
    fn map(self, value: f32, slope: f32) -> Self;
    fn scale(self, factor: f32) -> Self;
}

impl Number for f32 {
    #[inline]
    fn constant(value: f32) -> Self {
        value
    }
    #[inline]
    fn value(self) -> f32 {
        self
    }
    #[inline]
    fn map(self, value: f32, _slope: f32) -> Self {
        value
    }
    #[inline]
    fn scale(self, factor: f32) -> Self {
        self * factor
    }
}

impl Dual {
    /// The variable whose derivatives fill `lane`.
    pub fn variable(value: f32, lane: usize) -> Self {
        let mut slopes = [0.0; LANES];
        slopes[lane] = 1.0;
        Self { value, slopes }
    }
}

impl Number for Dual {
    #[inline]
    fn constant(value: f32) -> Self {
        Self { value, slopes: [0.0; LANES] }
    }
    #[inline]
    fn value(self) -> f32 {
        self.value
    }
    #[inline]
    fn map(self, value: f32, slope: f32) -> Self {
        Self { value, slopes: self.slopes.map(|s| s * slope) }
    }
    #[inline]
    fn scale(self, factor: f32) -> Self {
        self.map(self.value * factor, factor)
    }
}

impl Add for Dual {
    type Output = Self;
    #[inline]
    fn add(self, other: Self) -> Self {
        let slopes = std::array::from_fn(|i| self.slopes[i] + other.slopes[i]);
        Self { value: self.value + other.value, slopes }
    }
}

impl Sub for Dual {
    type Output = Self;
    #[inline]
    fn sub(self, other: Self) -> Self {
        let slopes = std::array::from_fn(|i| self.slopes[i] - other.slopes[i]);
        Self { value: self.value - other.value, slopes }
    }
}

impl Mul for Dual {
    type Output = Self;
    #[inline]
    #[allow(clippy::suspicious_arithmetic_impl, reason = "the product rule adds")]
    fn mul(self, other: Self) -> Self {
        let slopes = std::array::from_fn(|i| self.slopes[i] * other.value + self.value * other.slopes[i]);
        Self { value: self.value * other.value, slopes }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_derivatives() {
        let (x, y) = (Dual::variable(3.0, 0), Dual::variable(-2.0, 1));
        // (x·y - 4x)·y: by x y² - 4y = 12, by y 2xy - 4x = -24.
        let f = (x * y - x.scale(4.0)) * y;
        assert_eq!((f.value, f.slopes[0], f.slopes[1]), (36.0, 12.0, -24.0));
        // √x at 3, given its value and slope.
        let root = x.map(3_f32.sqrt(), 0.5 / 3_f32.sqrt());
        assert!((root * root).value - 3.0 < 1e-6 && ((root * root).slopes[0] - 1.0).abs() < 1e-6);
    }
}
