//! How noisy the values are, and which way they rise: running sums only.

/// Relative noise below which a frame is taken at its word.
const SILENT: f64 = 2e-5;

/// Noise of the focus values, relative to the value, from repeated frames of one place.
#[derive(Clone, Copy, Debug, Default)]
pub struct Noise {
    sum: f64,
    freedom: u32,
}

impl Noise {
    /// Takes in one more frame of a place: its value, the mean there before and after, and |Φ| there.
    pub fn add(&mut self, value: f64, before: f64, after: f64, scale: f64) {
        if scale > 0.0 {
            self.sum += (value - before) * (value - after) / (scale * scale);
            self.freedom += 1;
        }
    }

    /// Standard deviation of one frame, relative to its value.
    pub fn relative(&self) -> f64 {
        if self.freedom == 0 || self.is_none() { 0.0 } else { root(self.sum / f64::from(self.freedom)) }
    }

    /// Whether repeated frames were equal to the last bit.
    pub fn is_none(&self) -> bool {
        // Plus or minus: compared without software floats.
        self.sum.to_bits() << 1 == 0
    }

    /// Whether one frame is as good as many.
    pub fn is_silent(&self) -> bool {
        self.is_none() || self.sum <= SILENT * SILENT * f64::from(self.freedom)
    }
}

/// A straight line through all frames since the start: is there a slope, and how sure is it?
#[derive(Clone, Copy, Debug, Default)]
pub struct Trend {
    n: u32,
    x: f64,
    xx: f64,
    y: f64,
    xy: f64,
}

impl Trend {
    /// Takes in a value `y` at `x`, both relative to the first frame's.
    pub fn add(&mut self, x: f64, y: f64) {
        self.n += 1;
        self.x += x;
        self.xx += x * x;
        self.y += y;
        self.xy += x * y;
    }

    /// The slope over its standard error, if one frame deviates by `sigma`; infinite where `sigma` is 0.
    pub fn significance(&self, sigma: f64) -> f64 {
        let n = f64::from(self.n);
        let sxx = n * self.xx - self.x * self.x;
        let sxy = n * self.xy - self.x * self.y;
        if sxx <= 0.0 || sxy == 0.0 {
            return 0.0;
        }
        if sigma == 0.0 {
            return sxy / sigma;
        }
        // sxx and sxy carry a factor n each; one √n is left over.
        sxy / (sigma * root(sxx) * root(n))
    }
}

impl Trend {
    /// The slope of the line.
    pub fn slope(&self) -> f64 {
        let n = f64::from(self.n);
        let sxx = n * self.xx - self.x * self.x;
        if sxx > 0.0 { (n * self.xy - self.x * self.y) / sxx } else { 0.0 }
    }
}

/// √x by Newton's method: the same on every machine. 0 for what is not positive.
pub fn root(x: f64) -> f64 {
    if x <= 0.0 || !x.is_finite() {
        return 0.0;
    }
    // Halving the exponent is right to 4 %; each step squares the error.
    let mut y = f64::from_bits((x.to_bits() >> 1) + 0x1FF7_A3BE_A91D_9B1B);
    for _ in 0..4 {
        y = 0.5 * (y + x / y);
    }
    y
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn root_is_the_square_root(x in 1e-300f64..1e300) {
            let r = root(x);
            prop_assert!((r / x.sqrt() - 1.0).abs() < 1e-15);
        }

        #[test]
        fn a_slope_is_as_significant_as_the_textbook_says(slope in -1.0f64..1.0, shift in -5.0f64..5.0, n in 3usize..60) {
            let mut trend = Trend::default();
            let xs: [f64; 60] = core::array::from_fn(|i| i as f64 * 0.5);
            for x in &xs[..n] {
                trend.add(*x, shift + slope * x);
            }
            let mean = xs[..n].iter().sum::<f64>() / n as f64;
            let spread: f64 = xs[..n].iter().map(|x| (x - mean) * (x - mean)).sum();
            let expected = slope * spread.sqrt() / 0.1;
            prop_assert!((trend.significance(0.1) - expected).abs() <= 1e-9 * (1.0 + expected.abs()));
        }
    }
}
