//! What a pipette's end looks like: a cone, blurred more the farther its glass is from focus.
//!
//! Seven numbers say where it lies and how it is blurred; a few shapes (glass, lumen, halo) mix linearly to whatever the
//! light makes of it, dark or bright, and are solved for in each place (variable projection: Golub and Pereyra 1973).

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

/// Shapes that mix linearly.
pub const SHAPES: usize = 7;

/// Blur radius (px) of a picture in focus.
const SHARPEST_PX: f64 = 1.5;

impl Cone {
    pub fn to_array(self) -> [f64; PLACES] {
        [self.x, self.y, self.angle, self.ln_opening, self.ln_widening, self.blur, self.ln_slope]
    }

    pub fn from_array([x, y, angle, ln_opening, ln_widening, blur, ln_slope]: [f64; PLACES]) -> Self {
        Self { x, y, angle, ln_opening, ln_widening, blur, ln_slope }
    }

    /// The scale of what is seen at the tip: opening and blur together, px.
    pub fn grain(&self) -> f64 {
        self.ln_opening.exp().hypot(self.blur).hypot(SHARPEST_PX)
    }
}

/// A cone ready to be drawn on pixels `step` px wide.
pub struct Drawing {
    cone: Cone,
    cos: f64,
    sin: f64,
    opening: f64,
    widening: f64,
    slope: f64,
    sharpest2: f64,
    reach: f64,
}

impl Drawing {
    /// `reach`: distance (px) at which the background's slope is one unit.
    pub fn new(cone: Cone, step: f64, reach: f64) -> Self {
        let (sin, cos) = cone.angle.sin_cos();
        Self {
            cone,
            cos,
            sin,
            opening: cone.ln_opening.exp(),
            widening: cone.ln_widening.exp(),
            slope: cone.ln_slope.exp(),
            // A square pixel's variance is step²/12; a disc of radius r has r²/4.
            sharpest2: SHARPEST_PX * SHARPEST_PX + step * step / 3.0,
            reach,
        }
    }

    /// The shapes at a place in the picture: glass, lumen, halo, halo that changes sign through focus, and the light's
    /// level and two slopes.
    #[inline]
    pub fn shapes(&self, x: f64, y: f64) -> [f64; SHAPES] {
        let (dx, dy) = (x - self.cone.x, y - self.cone.y);
        let s = -(dx * self.cos + dy * self.sin);
        let t = dy * self.cos - dx * self.sin;
        let along = s.max(0.0);
        let half = self.opening + self.widening * along;
        let defocus = self.cone.blur + self.slope * along;
        let radius = (defocus * defocus + self.sharpest2).sqrt();
        // A disc's standard deviation is half its radius.
        let inverse = 2.0 / radius;
        let bar = |half: f64| step((t + half) * inverse) - step((t - half) * inverse);
        // The rim is a circle seen at a slant: on average its far side lies half an opening beyond the tip.
        let end = s + 0.5 * self.opening;
        let cut = step(end * inverse);
        let glass = bar(half) * cut;
        let lumen = bar(0.5 * half) * cut;
        let margin = 0.35 * half + 0.5 * radius;
        let halo = bar(half + margin) * step((end + margin) * inverse) - glass;
        [glass, lumen, halo, halo * defocus / radius, 1.0, dx / self.reach, dy / self.reach]
    }
}

const STEPS: usize = 1024;
const SUPPORT: f64 = 4.0;

/// The normal distribution's share below `x`, from a table.
#[inline]
fn step(x: f64) -> f64 {
    static TABLE: LazyLock<[f32; STEPS + 2]> = LazyLock::new(|| {
        let mut table = [1.0; STEPS + 2];
        for (i, value) in table.iter_mut().enumerate().take(STEPS + 1) {
            *value = normal_below(SUPPORT * (2.0 * i as f64 / STEPS as f64 - 1.0)) as f32;
        }
        table
    });
    let u = ((x + SUPPORT) * (STEPS as f64 / (2.0 * SUPPORT))).clamp(0.0, STEPS as f64);
    let i = u as usize;
    let (low, high) = (f64::from(TABLE[i]), f64::from(TABLE[i + 1]));
    low + (u - i as f64) * (high - low)
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
