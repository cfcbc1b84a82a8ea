//! What a pipette that swings sideways leaves of itself at its frequency.
//!
//! Frame k shows the pipette's light P moved by a·sin(φ_k) along n, across the pipette. The first harmonic of a pixel is the
//! mean of 2·sin φ·P(x − a·sin φ·n) over a period: −a·∂P/∂n while a is small, and no more than a mean of P at four places
//! otherwise (eight phases, of which two always agree, are exact for all that blurred light shows). P is the still detector's
//! cone: glass with its lumen and a seam of bent light, here for either of two kernels of blur.

use super::kernel::Kernel;
use crate::tip::model::{Cone, PLACES};
use crate::tip::optics;

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
    kernel: &'static Kernel,
    /// The tip, from the origin of the places asked for.
    tip: [f32; 2],
    cos: f32,
    sin: f32,
    opening: f32,
    widening: f32,
    blur: f32,
    slope: f32,
    /// The rim's far side beyond the tip, on average over its width, in openings; and its change with the slope's logarithm.
    rim: f32,
    rim_slope: f32,
    /// Squares of the blur radii in focus, of glass and of bent light.
    body2: f32,
    edge2: f32,
    unit: f32,
    amplitude: f32,
    lumen: f32,
    seam: f32,
    depth: f32,
    /// What is seen of the tip beside its axis, its swing and its blur in focus with it.
    reach: f32,
}

/// The pipette's light at a place, over its depth: what lumen and seam add to it for each unit of theirs, and how it changes
/// with the place across the axis, half of the outline's width, the glass's blur radius and the distance from the end.
struct Light {
    value: f32,
    lumen: f32,
    seam: f32,
    across: f32,
    half: f32,
    defocus: f32,
    end: f32,
}

impl Picture {
    /// Drawn on pixels `step` px wide, at places relative to `origin`. `unit`: how many times finer than the still detector's a
    /// pixel is.
    pub fn new(swinging: &Swinging, kernel: &'static Kernel, step: f64, origin: [f64; 2], unit: f64) -> Self {
        let cone = &swinging.cone;
        let (sin, cos) = cone.angle.sin_cos();
        let (opening, slope, amplitude) = (cone.ln_opening.exp(), cone.ln_slope.exp(), swinging.ln_amplitude.exp());
        // The rim is a circle seen at a slant, by as much as the blur grows along the shank.
        let descent = (slope / optics::BODY_SLOPE).atan();
        let rim = std::f64::consts::FRAC_PI_4 * descent.sin();
        // A square pixel's variance is step²/12, a disc's of radius r is r²/4.
        let sharpest2 = |radius: f64| ((radius * unit).powi(2) + step * step / 3.0) as f32;
        Self {
            kernel,
            tip: [(cone.x - origin[0]) as f32, (cone.y - origin[1]) as f32],
            cos: cos as f32,
            sin: sin as f32,
            opening: opening as f32,
            widening: cone.ln_widening.exp() as f32,
            blur: cone.blur as f32,
            slope: slope as f32,
            rim: rim as f32,
            rim_slope: (rim * descent.cos().powi(2)) as f32,
            body2: sharpest2(optics::BODY),
            edge2: sharpest2(optics::EDGE),
            unit: unit as f32,
            amplitude: amplitude as f32,
            lumen: swinging.lumen as f32,
            seam: swinging.seam as f32,
            depth: swinging.depth as f32,
            reach: (opening + amplitude + SHARP_PX * unit + step) as f32,
        }
    }

    /// Distances from the tip along the shank, and across it.
    #[inline(always)]
    fn along_across(&self, x: f32, y: f32) -> (f32, f32) {
        let (dx, dy) = (x - self.tip[0], y - self.tip[1]);
        (-(dx * self.cos + dy * self.sin), dy * self.cos - dx * self.sin)
    }

    /// Whether anything of the pipette is seen at a place: the light of a blurred edge ends two blur radii from it.
    #[inline(always)]
    fn shows(&self, x: f32, y: f32) -> bool {
        let (along, across) = self.along_across(x, y);
        let s = along.max(0.0);
        let reach = self.reach + 2.0 * (self.blur + self.slope * s).abs();
        across.abs() < reach + self.widening * s && along > -reach
    }

    #[inline(always)]
    fn light(&self, s: f32, t: f32) -> Light {
        let along = s.max(0.0);
        let (half, defocus) = (self.opening + self.widening * along, self.blur + self.slope * along);
        let end = s + self.rim * self.opening;
        let step = |x: f32| self.kernel.step(x);
        // Inverse standard deviations (a disc's is half its radius), and how they change with the defocus.
        let squared = defocus * defocus + self.body2;
        let body = 2.0 / squared.sqrt();
        let body_slope = -body * defocus / squared;
        let squared = defocus * defocus * (optics::EDGE_SLOPE * optics::EDGE_SLOPE) + self.edge2;
        let edge = 2.0 / squared.sqrt();
        let edge_slope = -edge * (optics::EDGE_SLOPE * optics::EDGE_SLOPE) * defocus / squared;
        let wide = edge / optics::SPREAD;
        // Either side of the glass and of the lumen, and the end.
        let (hole, share) = (optics::LUMEN * half, self.lumen - optics::BRIGHTNESS);
        let ((a, da), (b, db)) = (step((t + half) * body), step((t - half) * body));
        let ((c, dc), (d, dd)) = (step((t + hole) * body), step((t - hole) * body));
        let (cut, dcut) = step(end * body);
        let bar = (a - b) + share * (c - d);
        // The seam along them.
        let ((f, df), (g, dg)) = (step((t + half) * edge), step((t - half) * edge));
        let ((h, dh), (i, di)) = (step((t + half) * wide), step((t - half) * wide));
        let (trim, dtrim) = step(end * edge);
        let ring = (f - g) - (h - i);
        let u = (defocus - optics::NULL * self.unit) / (optics::DEPTH * self.unit);
        let fall = 1.0 + u * u;
        let strength = u / fall;
        let bent = self.seam * strength;
        let seam = ring * trim * strength;
        // By the sharpness of the glass and of the seam.
        let by_body =
            ((t + half) * da - (t - half) * db + share * ((t + hole) * dc - (t - hole) * dd)) * cut + bar * dcut * end;
        let by_edge = (t + half) * (df - dh / optics::SPREAD) - (t - half) * (dg - di / optics::SPREAD);
        let by_edge = bent * (by_edge * trim + ring * dtrim * end);
        let by_strength = self.seam * ring * trim * (1.0 - u * u) / (fall * fall * optics::DEPTH * self.unit);
        Light {
            value: bar * cut + self.seam * seam,
            lumen: (c - d) * cut,
            seam,
            across: body * ((da - db) + share * (dc - dd)) * cut + bent * trim * (edge * (df - dg) - wide * (dh - di)),
            half: body * ((da + db) + share * optics::LUMEN * (dc + dd)) * cut
                + bent * trim * (edge * (df + dg) - wide * (dh + di)),
            defocus: body_slope * by_body + edge_slope * by_edge + by_strength,
            end: bar * dcut * body + bent * ring * dtrim * edge,
        }
    }

    /// The first harmonic at a place, over the depth.
    pub fn shape(&self, x: f32, y: f32) -> f32 {
        if !self.shows(x, y) {
            return 0.0;
        }
        let (s, t) = self.along_across(x, y);
        let each = SINES.map(|sine| sine * self.light(s, t - self.amplitude * sine).value);
        0.5 * each.iter().sum::<f32>()
    }

    /// The first harmonic at a place, and how it changes with each number, in the order of [`Swinging::to_array`].
    pub fn value_and_slopes(&self, x: f32, y: f32) -> (f32, [f32; NUMBERS]) {
        if !self.shows(x, y) {
            return (0.0, [0.0; NUMBERS]);
        }
        let (s, still) = self.along_across(x, y);
        let behind = if s > 0.0 { s } else { 0.0 };
        let (mut shape, mut by) = (0.0, [0.0_f32; NUMBERS]);
        for sine in SINES {
            let t = still - self.amplitude * sine;
            let light = self.light(s, t);
            let w = 0.5 * sine;
            shape += w * light.value;
            // Behind the tip only, width and blur change along the shank.
            let (wider, blurred) =
                if s > 0.0 { (light.half * self.widening, light.defocus * self.slope) } else { (0.0, 0.0) };
            let by_s = light.end + wider + blurred;
            let each = [
                by_s * self.cos + light.across * self.sin,
                by_s * self.sin - light.across * self.cos,
                // The swing turns with the pipette: a turn moves the still place about the tip.
                s * light.across - still * by_s,
                self.opening * (light.half + self.rim * light.end),
                wider * behind,
                light.defocus,
                blurred * behind + light.end * self.opening * self.rim_slope,
                -self.amplitude * sine * light.across,
                light.lumen,
                light.seam,
            ];
            for (sum, each) in by.iter_mut().zip(each) {
                *sum += w * each;
            }
        }
        by.iter_mut().for_each(|d| *d *= self.depth);
        by[PLACES + 3] = shape;
        (self.depth * shape, by)
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
        // A pipette that hardly swings is that swing's derivative: its first harmonic over the swing, summed up sideways, is
        // the pipette itself.
        let barely = |s: f64| Swinging { ln_amplitude: s, ..SWINGING };
        let (sin, cos) = (0.7_f32.sin(), 0.7_f32.cos());
        for kernel in Kernel::both() {
            let derivative = Picture::new(&barely(-4.0), kernel, 1.0, [0.0, 0.0], 1.0);
            let swung = Picture::new(&SWINGING, kernel, 1.0, [0.0, 0.0], 1.0);
            for (x, y) in AT {
                let still = |by: f32| {
                    let far = (0..800).map(|k| by - 0.1 * (k as f32 + 0.5));
                    far.map(|b| -0.1 * derivative.shape(x - b * sin, y + b * cos) / (-4.0_f32).exp()).sum::<f32>()
                };
                let n = 180;
                let harmonic: f32 = (0..n)
                    .map(|k| {
                        let phase = (TAU * (f64::from(k) + 0.5) / f64::from(n)).sin() as f32;
                        2.0 * phase * still(-1.4_f32.exp() * phase) / n as f32
                    })
                    .sum();
                let value = swung.value_and_slopes(x, y).0;
                assert!((value + 100.0 * harmonic).abs() < 1.0, "{x},{y}: {value} {}", -100.0 * harmonic);
            }
        }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        const STEP: f64 = 4e-3;
        let gaussian = Kernel::both()[0];
        for (x, y) in AT {
            let (_, slopes) = Picture::new(&SWINGING, gaussian, 1.0, [0.0, 0.0], 1.0).value_and_slopes(x, y);
            for (k, slope) in slopes.iter().enumerate() {
                let moved = |d: f64| {
                    let mut numbers = SWINGING.to_array();
                    numbers[k] += d;
                    Picture::new(&Swinging::from_array(numbers), gaussian, 1.0, [0.0, 0.0], 1.0)
                        .value_and_slopes(x, y)
                        .0
                };
                let difference = (moved(STEP) - moved(-STEP)) / (2.0 * STEP as f32);
                assert!((slope - difference).abs() < 2.0 + 0.02 * slope.abs(), "{x},{y} by {k}: {slope} {difference}");
            }
        }
    }
}
