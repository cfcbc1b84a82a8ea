//! What a pipette's end looks like: a cone, blurred more the farther its glass is from focus.
//!
//! Seven numbers say where it lies and how it is blurred; three shapes (glass, lumen, seam) mix linearly to whatever the
//! light makes of it, dark or bright, and are solved for in each place (variable projection: Golub and Pereyra 1973). How
//! glass and the light bent at its walls blur and turn with depth is what a real focal stack shows (`docs/tips.md`).

use super::dual::{Dual, Number};
use std::sync::LazyLock;

/// Place and shape of a pipette's end. Lengths are px of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    /// The tip, the centre of the rim: column and row.
    pub x: f64,
    pub y: f64,
    /// Direction in which the tip points, from x (right) towards y (down), rad.
    pub angle: f64,
    /// Radius of the opening, as a natural logarithm.
    pub ln_opening: f64,
    /// Half width that the outline gains per px along the shank, as a natural logarithm.
    pub ln_widening: f64,
    /// Blur radius of the tip; negative if the focal plane lies above it, so that a part of the shank is in focus.
    pub blur: f64,
    /// Blur radius gained per px along the shank, as a natural logarithm.
    pub ln_slope: f64,
}

/// Numbers of a [`Cone`].
pub const PLACES: usize = 7;

/// Shapes of the pipette that mix linearly: glass with its lumen, what the lumen differs by, and the seam of bent light.
pub const GLASS: usize = 3;

/// Optics of a 40x/0.8 W objective at 0.32 µm/px, from a real focal stack; lengths in px, heights as the blur radius that they
/// make. Another pixel size multiplies all of them.
mod optics {
    /// Blur radius of glass in focus, and of bent light.
    pub const BODY: f64 = 2.16;
    pub const EDGE: f64 = 3.55;
    /// Blur radius of glass that a unit of height adds: the tangent of the objective's half angle.
    pub const BODY_SLOPE: f64 = 0.753;
    /// Blur of bent light over that of glass, far from focus.
    pub const EDGE_SLOPE: f32 = 0.133;
    /// Height at which walls bend no light, and from there to where they bend most.
    pub const NULL: f32 = 3.44;
    pub const DEPTH: f32 = 5.64;
    /// Width of the seam over the blur of its edge.
    pub const SPREAD: f32 = 1.327;
    /// Radius of the lumen over that of the glass, and how much of the glass's darkness it lacks.
    pub const LUMEN: f32 = 0.508;
    pub const BRIGHTNESS: f32 = 0.524;
}

impl Cone {
    pub fn to_array(self) -> [f64; PLACES] {
        [self.x, self.y, self.angle, self.ln_opening, self.ln_widening, self.blur, self.ln_slope]
    }

    #[cfg(test)]
    pub fn from_array([x, y, angle, ln_opening, ln_widening, blur, ln_slope]: [f64; PLACES]) -> Self {
        Self { x, y, angle, ln_opening, ln_widening, blur, ln_slope }
    }
}

/// A cone ready to be drawn.
pub struct Drawing {
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
    /// Pixel sizes of [`optics`] in a pixel.
    unit: f32,
}

/// What a place's light depends on, px: its distance from the axis, half of the outline's width there, the glass's blur radius
/// with its sign, and the distance from the rim's far side, along the axis.
struct Place<N> {
    across: N,
    half: N,
    defocus: N,
    end: N,
}

/// A square pixel's variance is step²/12, a disc's of radius r is r²/4.
fn sharpest2(radius: f64, step: f64) -> f32 {
    (radius * radius + step * step / 3.0) as f32
}

impl Drawing {
    /// Drawn on pixels `step` px wide, at places relative to `origin`. `unit`: how many times finer than [`optics`] a pixel is.
    pub fn new(cone: &Cone, step: f64, origin: [f64; 2], unit: f64) -> Self {
        // The rim is a circle seen at a slant, by as much as the blur grows along the shank.
        let descent = (cone.ln_slope.exp() / optics::BODY_SLOPE).atan();
        let rim = std::f64::consts::FRAC_PI_4 * descent.sin();
        Self {
            rim: rim as f32,
            rim_slope: (rim * descent.cos().powi(2)) as f32,
            tip: [(cone.x - origin[0]) as f32, (cone.y - origin[1]) as f32],
            cos: cone.angle.cos() as f32,
            sin: cone.angle.sin() as f32,
            opening: cone.ln_opening.exp() as f32,
            widening: cone.ln_widening.exp() as f32,
            blur: cone.blur as f32,
            slope: cone.ln_slope.exp() as f32,
            body2: sharpest2(optics::BODY * unit, step),
            edge2: sharpest2(optics::EDGE * unit, step),
            unit: unit as f32,
        }
    }

    /// Distances from the tip along the shank, and across it.
    #[inline]
    fn along_across(&self, x: f32, y: f32) -> (f32, f32) {
        let (dx, dy) = (x - self.tip[0], y - self.tip[1]);
        (-(dx * self.cos + dy * self.sin), dy * self.cos - dx * self.sin)
    }

    #[inline]
    fn place(&self, s: f32, across: f32) -> Place<f32> {
        let along = s.max(0.0);
        Place {
            across,
            half: self.opening + self.widening * along,
            defocus: self.blur + self.slope * along,
            end: s + self.rim * self.opening,
        }
    }

    /// The pipette's shapes at a place.
    #[inline]
    pub fn shapes(&self, x: f32, y: f32) -> [f32; GLASS] {
        let (s, across) = self.along_across(x, y);
        self.light(&self.place(s, across))
    }

    /// How the shapes, mixed, change with each of the cone's numbers, in the order of [`Cone::to_array`].
    #[inline]
    pub fn slopes(&self, x: f32, y: f32, mix: &[f32; GLASS]) -> [f32; PLACES] {
        let (s, t) = self.along_across(x, y);
        let Place { across, half, defocus, end } = self.place(s, t);
        let shapes = self.light(&Place {
            across: Dual::variable(across, 0),
            half: Dual::variable(half, 1),
            defocus: Dual::variable(defocus, 2),
            end: Dual::variable(end, 3),
        });
        let by = |k: usize| shapes.iter().zip(mix).map(|(shape, m)| m * shape.slopes[k]).sum::<f32>();
        let (across, half, defocus, end) = (by(0), by(1), by(2), by(3));
        // Behind the tip only, width and blur change along the shank.
        let (along, wider, blurred) =
            if s > 0.0 { (s, half * self.widening, defocus * self.slope) } else { (0.0, 0.0, 0.0) };
        let by_s = end + wider + blurred;
        [
            by_s * self.cos + across * self.sin,
            by_s * self.sin - across * self.cos,
            -t * by_s + s * across,
            self.opening * (half + self.rim * end),
            wider * along,
            defocus,
            blurred * along + end * self.opening * self.rim_slope,
        ]
    }

    #[inline]
    fn light<N: Number>(&self, place: &Place<N>) -> [N; GLASS] {
        let &Place { across, half, defocus, end } = place;
        // A disc's standard deviation is half its radius: its inverse is two over the radius.
        let sharpness = |square: N| {
            let inverse = 2.0 / square.value().sqrt();
            square.map(inverse, -0.5 * inverse / square.value())
        };
        let squared = defocus * defocus;
        let sharp = sharpness(squared + N::constant(self.body2));
        let edge = sharpness(squared.scale(optics::EDGE_SLOPE * optics::EDGE_SLOPE) + N::constant(self.edge2));
        let bar = |half: N, sharp: N| step((across + half) * sharp) - step((across - half) * sharp);
        let cut = step(end * sharp);
        let lumen = bar(half.scale(optics::LUMEN), sharp) * cut;
        let glass = bar(half, sharp) * cut - lumen.scale(optics::BRIGHTNESS);
        let seam = (bar(half, edge) - bar(half, edge.scale(1.0 / optics::SPREAD))) * step(end * edge);
        // A seam is bright below focus and dark above it, or the other way round.
        let height = (defocus - N::constant(optics::NULL * self.unit)).scale(1.0 / (optics::DEPTH * self.unit));
        let u = height.value();
        let fall = 1.0 + u * u;
        let strength = height.map(u / fall, (1.0 - u * u) / (fall * fall));
        [glass, lumen, seam * strength]
    }
}

const STEPS: usize = 1024;
const SUPPORT: f32 = 4.0;

/// The normal distribution's share below `x`, from a table.
#[inline]
fn step<N: Number>(x: N) -> N {
    static TABLE: LazyLock<[f32; STEPS + 2]> = LazyLock::new(|| {
        // Flat from its ends on: a last tread would have a slope that everything beyond it seems to have.
        let mut table = [1.0; STEPS + 2];
        for (i, value) in table.iter_mut().enumerate().take(STEPS) {
            *value = normal_below(f64::from(SUPPORT) * (2.0 * i as f64 / STEPS as f64 - 1.0)) as f32;
        }
        table[0] = 0.0;
        table[1] = 0.0;
        table
    });
    let scale = STEPS as f32 / (2.0 * SUPPORT);
    let u = ((x.value() + SUPPORT) * scale).clamp(0.0, STEPS as f32);
    let i = u as usize;
    let (low, high) = (TABLE[i], TABLE[i + 1]);
    x.map(low + (u - i as f32) * (high - low), (high - low) * scale)
}

/// The share of a standard normal distribution below `x`, by its power series (Marsaglia 2004).
fn normal_below(x: f64) -> f64 {
    let (mut term, mut sum, mut n) = (x, x, 1.0);
    while term.abs() > 1e-15 {
        n += 2.0;
        term *= x * x / n;
        sum += term;
    }
    0.5 + sum * (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_agree_with_differences() {
        let cone =
            Cone { x: 40.0, y: 30.0, angle: 0.7, ln_opening: 1.1, ln_widening: -1.6, blur: -5.0, ln_slope: -0.8 };
        let at = [(28.0, 19.0), (39.0, 31.5), (35.0, 24.0), (10.0, 8.0)];
        for (x, y) in at {
            for mix in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
                let slopes = Drawing::new(&cone, 2.0, [0.0, 0.0], 1.0).slopes(x, y, &mix);
                for (k, slope) in slopes.iter().enumerate() {
                    let moved = |d: f64| {
                        let mut p = cone.to_array();
                        p[k] += d;
                        let shapes = Drawing::new(&Cone::from_array(p), 2.0, [0.0, 0.0], 1.0).shapes(x, y);
                        shapes.iter().zip(&mix).map(|(s, m)| s * m).sum::<f32>()
                    };
                    // Small enough that an angle moves a point at the lever's end by less than a tenth of a pixel.
                    const STEP: f64 = 4e-3;
                    let difference = (moved(STEP) - moved(-STEP)) / (2.0 * STEP as f32);
                    assert!((slope - difference).abs() < 0.02, "{x},{y} shape {mix:?} by {k}: {slope} {difference}");
                }
            }
        }
    }
}
