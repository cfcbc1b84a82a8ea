//! What a pipette that swings sideways leaves of itself at its frequency.
//!
//! Frame k shows the pipette's light P moved by a·sin(φ_k) along n, across the pipette. The first harmonic of a pixel is the
//! mean of 2·sin φ·P(x − a·sin φ·n) over a period: −a·∂P/∂n while a is small, and no more than a mean of P at four places
//! otherwise (eight phases, of which two always agree, are exact for all that blurred light shows).

use crate::tip::model::{Cone, Drawing, GLASS, PLACES};

/// A pipette and its swing.
#[derive(Clone, Copy, Debug)]
pub struct Swinging {
    pub cone: Cone,
    /// Half of the way from turn to turn, px, as a natural logarithm.
    pub ln_amplitude: f64,
    /// How much light the lumen and the seam change, over what the glass does.
    pub lumen: f64,
    pub seam: f64,
    /// What the glass does, grey values.
    pub depth: f64,
}

/// Numbers of a [`Swinging`].
pub const NUMBERS: usize = PLACES + 4;

impl Swinging {
    pub fn to_array(self) -> [f64; NUMBERS] {
        let [x, y, angle, ln_opening, ln_widening, blur, ln_slope] = self.cone.to_array();
        let Self { ln_amplitude, lumen, seam, depth, .. } = self;
        [x, y, angle, ln_opening, ln_widening, blur, ln_slope, ln_amplitude, lumen, seam, depth]
    }

    pub fn from_array(numbers: [f64; NUMBERS]) -> Self {
        let [x, y, angle, ln_opening, ln_widening, blur, ln_slope, ln_amplitude, lumen, seam, depth] = numbers;
        let cone = Cone { x, y, angle, ln_opening, ln_widening, blur, ln_slope };
        Self { cone, ln_amplitude, lumen, seam, depth }
    }
}

/// Sines of the phases that stand for a period.
const SINES: [f32; 4] = [-0.923_879_5, -0.382_683_43, 0.382_683_43, 0.923_879_5];

/// Reach of an edge's light in focus, px at the still detector's size.
const SHARP_PX: f64 = 10.0;

/// A swinging pipette ready to be drawn.
pub struct Picture {
    drawing: Drawing,
    tip: [f32; 2],
    /// Half of the outline's width at the tip and its gain along the shank, with the swing and what blurs them in focus.
    width: f32,
    widening: f32,
    blur: f32,
    slope: f32,
    mix: [f32; GLASS],
    depth: f32,
    amplitude: f32,
    sin: f32,
    cos: f32,
}

impl Picture {
    /// As [`Drawing::new`].
    pub fn new(swinging: &Swinging, step: f64, origin: [f64; 2], unit: f64) -> Self {
        let (sin, cos) = swinging.cone.angle.sin_cos();
        let cone = &swinging.cone;
        let sharp = SHARP_PX * unit + step;
        Self {
            drawing: Drawing::new(cone, step, origin, unit),
            tip: [(cone.x - origin[0]) as f32, (cone.y - origin[1]) as f32],
            width: (cone.ln_opening.exp() + swinging.ln_amplitude.exp() + sharp) as f32,
            widening: cone.ln_widening.exp() as f32,
            blur: cone.blur as f32,
            slope: cone.ln_slope.exp() as f32,
            mix: [1.0, swinging.lumen as f32, swinging.seam as f32],
            depth: swinging.depth as f32,
            amplitude: swinging.ln_amplitude.exp() as f32,
            sin: sin as f32,
            cos: cos as f32,
        }
    }

    /// Whether anything of the pipette is seen at a place: the light of a blurred edge ends two blur radii from it.
    fn shows(&self, x: f32, y: f32) -> bool {
        let (dx, dy) = (x - self.tip[0], y - self.tip[1]);
        let (along, across) = (-(dx * self.cos + dy * self.sin), dy * self.cos - dx * self.sin);
        let s = along.max(0.0);
        let reach = self.width + 2.0 * (self.blur + self.slope * s).abs();
        across.abs() < reach + self.widening * s && along > -reach
    }

    /// The first harmonic at a place, over the depth.
    pub fn shape(&self, x: f32, y: f32) -> f32 {
        if !self.shows(x, y) {
            return 0.0;
        }
        let each = SINES.map(|s| {
            let by = self.amplitude * s;
            let shapes = self.drawing.shapes(x + by * self.sin, y - by * self.cos);
            s * shapes.iter().zip(&self.mix).map(|(shape, m)| shape * m).sum::<f32>()
        });
        0.5 * each.iter().sum::<f32>()
    }

    /// The first harmonic at a place, and how it changes with each number, in the order of [`Swinging::to_array`].
    pub fn value_and_slopes(&self, x: f32, y: f32) -> (f32, [f32; NUMBERS]) {
        let (mut shape, mut slopes) = (0.0, [0.0_f32; NUMBERS]);
        if !self.shows(x, y) {
            return (shape, slopes);
        }
        for s in SINES {
            let by = self.amplitude * s;
            let (px, py) = (x + by * self.sin, y - by * self.cos);
            let [glass, lumen, seam] = self.drawing.shapes(px, py);
            let d = self.drawing.slopes(px, py, &self.mix);
            let w = 0.5 * s;
            shape += w * (glass + self.mix[1] * lumen + self.mix[2] * seam);
            for (sum, d) in slopes.iter_mut().zip(&d) {
                *sum += w * d;
            }
            // The swing turns with the pipette.
            slopes[2] -= w * by * (self.cos * d[0] + self.sin * d[1]);
            slopes[PLACES] += w * by * (self.cos * d[1] - self.sin * d[0]);
            slopes[PLACES + 1] += w * lumen;
            slopes[PLACES + 2] += w * seam;
        }
        slopes.iter_mut().for_each(|d| *d *= self.depth);
        slopes[PLACES + 3] = shape;
        (self.depth * shape, slopes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const SWINGING: Swinging = Swinging {
        cone: Cone { x: 40.0, y: 30.0, angle: 0.7, ln_opening: 1.1, ln_widening: -1.6, blur: -5.0, ln_slope: -0.8 },
        ln_amplitude: 1.4,
        lumen: 0.3,
        seam: 2.0,
        depth: -100.0,
    };
    const AT: [(f32, f32); 5] = [(28.0, 19.0), (39.0, 31.5), (35.0, 24.0), (10.0, 8.0), (42.0, 28.0)];

    #[test]
    fn it_is_the_first_harmonic_of_a_moving_pipette() {
        let still = Drawing::new(&SWINGING.cone, 1.0, [0.0, 0.0], 1.0);
        let (sin, cos) = (0.7_f32.sin(), 0.7_f32.cos());
        for (x, y) in AT {
            let n = 360;
            let harmonic: f32 = (0..n)
                .map(|k| {
                    let phase = (TAU * f64::from(k) / f64::from(n)).sin() as f32;
                    let by = 1.4_f32.exp() * phase;
                    let [glass, lumen, seam] = still.shapes(x + by * sin, y - by * cos);
                    2.0 * phase * (glass + 0.3 * lumen + 2.0 * seam) / n as f32
                })
                .sum();
            let (value, _) = Picture::new(&SWINGING, 1.0, [0.0, 0.0], 1.0).value_and_slopes(x, y);
            assert!((value + 100.0 * harmonic).abs() < 0.6, "{x},{y}: {value} {}", -100.0 * harmonic);
        }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        const STEP: f64 = 4e-3;
        for (x, y) in AT {
            let (_, slopes) = Picture::new(&SWINGING, 1.0, [0.0, 0.0], 1.0).value_and_slopes(x, y);
            for (k, slope) in slopes.iter().enumerate() {
                let moved = |d: f64| {
                    let mut numbers = SWINGING.to_array();
                    numbers[k] += d;
                    Picture::new(&Swinging::from_array(numbers), 1.0, [0.0, 0.0], 1.0).value_and_slopes(x, y).0
                };
                let difference = (moved(STEP) - moved(-STEP)) / (2.0 * STEP as f32);
                assert!((slope - difference).abs() < 2.0 + 0.02 * slope.abs(), "{x},{y} by {k}: {slope} {difference}");
            }
        }
    }
}
