//! What a pipette's end looks like: a cone, blurred more the farther its glass is from focus.
//!
//! Seven numbers say where it lies and how it is blurred; three shapes (glass, lumen, seam) mix linearly to whatever the
//! light makes of it, dark or bright, and are solved for in each place (variable projection: Golub and Pereyra 1973). How
//! glass and the light bent at its walls blur and turn with depth is what a real focal stack shows (`docs/tips.md`).

use super::optics;

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

/// What the seam is of the glass with a real objective's bent light at half strength, and how far it may be from that.
pub const SEAM: f64 = 2.5;
pub const SEAM_DEVIATION: f64 = 1.5;

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
    /// One over the depth of the bent light, in px.
    per_depth: f32,
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
            per_depth: 1.0 / (optics::DEPTH * unit as f32),
        }
    }

    /// Distances from the tip along the shank, and across it.
    #[inline(always)]
    fn along_across(&self, x: f32, y: f32) -> (f32, f32) {
        let (dx, dy) = (x - self.tip[0], y - self.tip[1]);
        (-(dx * self.cos + dy * self.sin), dy * self.cos - dx * self.sin)
    }

    /// One over the standard deviation of a blur: a disc's is half its radius.
    #[inline(always)]
    fn sharpness(&self, defocus: f32) -> (f32, f32) {
        let squared = defocus * defocus;
        let edge = squared * (optics::EDGE_SLOPE * optics::EDGE_SLOPE) + self.edge2;
        (2.0 / (squared + self.body2).sqrt(), 2.0 / edge.sqrt())
    }

    /// Height over where walls bend no light, in units of the way to where they bend most.
    #[inline(always)]
    fn height(&self, defocus: f32) -> f32 {
        (defocus - optics::NULL * self.unit) * self.per_depth
    }

    /// The pipette's shapes at a place. Without branches, so that a loop over places fills whole registers; without `SEAM`
    /// that shape is 0.
    #[inline(always)]
    pub fn shapes<const SEAM: bool>(&self, x: f32, y: f32) -> [f32; GLASS] {
        let (s, t) = self.along_across(x, y);
        let along = s.max(0.0);
        let (half, defocus) = (self.opening + self.widening * along, self.blur + self.slope * along);
        let end = s + self.rim * self.opening;
        let (sharp, edge) = self.sharpness(defocus);
        let bar = |half: f32, sharp: f32| step((t + half) * sharp).0 - step((t - half) * sharp).0;
        let cut = step(end * sharp).0;
        let lumen = bar(half * optics::LUMEN, sharp) * cut;
        let glass = bar(half, sharp) * cut - lumen * optics::BRIGHTNESS;
        if !SEAM {
            return [glass, lumen, 0.0];
        }
        let seam = (bar(half, edge) - bar(half, edge * (1.0 / optics::SPREAD))) * step(end * edge).0;
        // A seam is bright below focus and dark above it, or the other way round.
        let u = self.height(defocus);
        [glass, lumen, seam * (u / (1.0 + u * u))]
    }

    /// How the shapes, mixed, change with each of the cone's numbers, in the order of [`Cone::to_array`].
    #[inline(always)]
    pub fn slopes<const SEAM: bool>(&self, x: f32, y: f32, mix: &[f32; GLASS]) -> [f32; PLACES] {
        let (s, t) = self.along_across(x, y);
        let along = s.max(0.0);
        let (half, defocus) = (self.opening + self.widening * along, self.blur + self.slope * along);
        let end = s + self.rim * self.opening;
        let (sharp, edge) = self.sharpness(defocus);
        // A bar's value, and its derivatives by place, half width and sharpness.
        let bar = |half: f32, sharp: f32| {
            let ((right, dr), (left, dl)) = (step((t + half) * sharp), step((t - half) * sharp));
            [right - left, sharp * (dr - dl), sharp * (dr + dl), (t + half) * dr - (t - half) * dl]
        };
        let (glass, lumen) = (bar(half, sharp), bar(half * optics::LUMEN, sharp));
        let hollow = mix[1] - mix[0] * optics::BRIGHTNESS;
        let body = |k: usize, factor: f32| mix[0] * glass[k] + hollow * factor * lumen[k];
        let (cut, dcut) = step(end * sharp);
        let mixed = body(0, 1.0);
        let mut by_across = cut * body(1, 1.0);
        let mut by_half = cut * body(2, optics::LUMEN);
        let mut by_end = mixed * dcut * sharp;
        let by_sharp = cut * body(3, 1.0) + mixed * dcut * end;
        let mut by_defocus = -0.25 * sharp * sharp * sharp * defocus * by_sharp;
        if SEAM {
            let spread = 1.0 / optics::SPREAD;
            let (near, wide) = (bar(half, edge), bar(half, edge * spread));
            let (cut, dcut) = step(end * edge);
            let u = self.height(defocus);
            let fall = 1.0 / (1.0 + u * u);
            let strength = mix[2] * u * fall;
            let seam = near[0] - wide[0];
            by_across += strength * cut * (near[1] - wide[1]);
            by_half += strength * cut * (near[2] - wide[2]);
            by_end += strength * seam * dcut * edge;
            let by_edge = strength * (cut * (near[3] - wide[3] * spread) + seam * dcut * end);
            let slope = optics::EDGE_SLOPE * optics::EDGE_SLOPE;
            by_defocus += -0.25 * slope * edge * edge * edge * defocus * by_edge;
            by_defocus += mix[2] * seam * cut * (1.0 - u * u) * fall * fall * self.per_depth;
        }
        // Behind the tip only, width and blur change along the shank.
        let behind = if s > 0.0 { 1.0 } else { 0.0 };
        let (wider, blurred) = (behind * by_half * self.widening, behind * by_defocus * self.slope);
        let by_s = by_end + wider + blurred;
        [
            by_s * self.cos + by_across * self.sin,
            by_s * self.sin - by_across * self.cos,
            s * by_across - t * by_s,
            self.opening * (by_half + self.rim * by_end),
            wider * along,
            by_defocus,
            blurred * along + by_end * self.opening * self.rim_slope,
        ]
    }
}

/// The normal distribution's share below `x`, and its density: a rational function, exact to 3·10⁻⁴ (Abramowitz and Stegun
/// 1964, 7.1.27), and its derivative.
#[inline(always)]
fn step(x: f32) -> (f32, f32) {
    let z = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let p = 1.0 + z * (0.278_393 + z * (0.230_389 + z * (0.000_972 + z * 0.078_108)));
    let slope = 0.278_393 + z * (2.0 * 0.230_389 + z * (3.0 * 0.000_972 + z * (4.0 * 0.078_108)));
    let square = p * p;
    let tail = 0.5 / (square * square);
    let share = if x < 0.0 { tail } else { 1.0 - tail };
    (share, 4.0 * std::f32::consts::FRAC_1_SQRT_2 * slope * tail / p)
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
                let slopes = Drawing::new(&cone, 2.0, [0.0, 0.0], 1.0).slopes::<true>(x, y, &mix);
                for (k, slope) in slopes.iter().enumerate() {
                    let moved = |d: f64| {
                        let mut p = cone.to_array();
                        p[k] += d;
                        let shapes = Drawing::new(&Cone::from_array(p), 2.0, [0.0, 0.0], 1.0).shapes::<true>(x, y);
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
