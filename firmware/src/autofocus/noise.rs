//! How noisy the values are, and which way they rise: running sums only.

/// Noise of the focus values, relative to the value, from repeated frames of one place.
#[derive(Clone, Copy, Debug, Default)]
pub struct Noise {
    /// Sum of squared relative deviations.
    sum: f64,
    /// How many deviations are independent.
    freedom: u32,
}

impl Noise {
    /// Takes in one more frame of a place: its value, and the mean there before and after.
    pub fn add(&mut self, value: f64, before: f64, after: f64, scale: f64) {
        if scale > 0.0 {
            self.sum += (value - before) * (value - after) / (scale * scale);
            self.freedom += 1;
        }
    }

    /// Independent deviations seen.
    pub fn freedom(&self) -> u32 {
        self.freedom
    }

    /// Relative standard deviation of one frame.
    pub fn relative(&self) -> f64 {
        if self.freedom == 0 { 0.0 } else { root(self.sum / f64::from(self.freedom)) }
    }
}

/// A straight line through all frames since the start: is there a slope, and how sure is it?
#[derive(Clone, Copy, Debug, Default)]
pub struct Trend {
    n: f64,
    x: f64,
    xx: f64,
    y: f64,
    xy: f64,
}

impl Trend {
    /// Takes in a value `y` at `x`, both relative to the first frame's.
    pub fn add(&mut self, x: f64, y: f64) {
        self.n += 1.0;
        self.x += x;
        self.xx += x * x;
        self.y += y;
        self.xy += x * y;
    }

    /// The slope over its standard error, if one frame deviates by `sigma`; infinite where `sigma` is 0.
    pub fn significance(&self, sigma: f64) -> f64 {
        let sxx = self.n * self.xx - self.x * self.x;
        let sxy = self.n * self.xy - self.x * self.y;
        if sxx <= 0.0 || sxy == 0.0 {
            return 0.0;
        }
        // sxx and sxy carry a factor n each; one √n is left over.
        sxy / (sigma * root(sxx) * root(self.n))
    }
}

/// √x by Newton's method: the same on every machine. 0 for what is not positive.
pub fn root(x: f64) -> f64 {
    if x <= 0.0 || !x.is_finite() {
        return 0.0;
    }
    // Halving the exponent is right to 6 %; three steps make it exact to rounding.
    let mut y = f64::from_bits((x.to_bits() >> 1) + 0x1FF7_A3BE_A91D_9B1B);
    for _ in 0..4 {
        y = 0.5 * (y + x / y);
    }
    y
}
