//! How an objective blurs an edge that lies out of focus.

use std::f64::consts::PI;
use std::sync::LazyLock;

/// What the objective and the condenser do to matter at a distance from the focal plane.
///
/// Matter `d` away from focus is blurred over a radius of `√(r₀² + (k·d)²)`. Absorbed light fills the objective's
/// aperture and blurs by its cone; light bent at a wall keeps to the condenser's smaller one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optics {
    /// Blur radius of a dark body in focus, µm.
    pub body_radius_um: f64,
    /// Blur radius that each µm of defocus adds to a dark body: the tangent of the objective's half angle.
    pub body_slope: f64,
    /// Blur radius of the light bent at a wall, in focus, µm.
    pub edge_radius_um: f64,
    /// Blur radius that each µm of defocus adds to bent light.
    pub edge_slope: f64,
    /// Bent light over absorbed light. An edge's bright seam turns dark on the other side of focus.
    pub edge_gain: f64,
    /// Defocus at which bent light is strongest, µm.
    pub edge_depth_um: f64,
    /// Height above the focal plane at which a wall bends no light in or out, µm.
    pub edge_null_um: f64,
    /// Width of the seam, as a multiple of the edge's own blur.
    pub edge_spread: f64,
    /// How the blur is spread over its radius.
    pub kernel: Kernel,
}

/// How a point out of focus is spread.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kernel {
    /// Evenly over a disc: geometric optics with a full aperture.
    Disc,
    /// A Gaussian of the disc's variance (a standard deviation of half the radius): an apodised aperture.
    Gaussian,
}

impl Optics {
    /// An Olympus LUMPlanFL N 40x/0.8 W: the body's slope is tan(asin(0.8 / 1.333)), 23.5 px of blur radius at 10 µm of
    /// defocus and 0.32 µm/px; the rest is fitted to the focus curve of a real pipette's tip (`docs/tips.md`).
    pub const WATER_40X: Self = Self {
        body_radius_um: 0.692,
        body_slope: 0.753,
        edge_radius_um: 1.136,
        edge_slope: 0.1,
        edge_gain: -4.98,
        edge_depth_um: 2.395,
        edge_null_um: 1.463,
        edge_spread: 1.327,
        kernel: Kernel::Disc,
    };

    /// A 20x/0.5 dry objective, not fitted to a real one: the other's radii scaled by 1/NA and its depths by 1/NA², as
    /// diffraction does; the body's slope is tan(asin(0.5)).
    pub const DRY_20X: Self = Self {
        body_radius_um: 1.107,
        body_slope: 0.577,
        edge_radius_um: 1.818,
        edge_slope: 0.0625,
        edge_gain: -4.98,
        edge_depth_um: 6.131,
        edge_null_um: 3.745,
        edge_spread: 1.327,
        kernel: Kernel::Disc,
    };

    /// A 4x/0.1 dry objective, scaled likewise.
    pub const DRY_4X: Self = Self {
        body_radius_um: 5.536,
        body_slope: 0.1005,
        edge_radius_um: 9.088,
        edge_slope: 0.0125,
        edge_gain: -4.98,
        edge_depth_um: 153.3,
        edge_null_um: 93.6,
        edge_spread: 1.327,
        kernel: Kernel::Disc,
    };

    /// Blur radius (µm) of a dark body `defocus_um` above or below focus.
    pub fn body_blur_um(&self, defocus_um: f64) -> f64 {
        self.body_radius_um.hypot(self.body_slope * defocus_um)
    }

    /// Blur radius (µm) of the light bent at a wall `defocus_um` above or below focus.
    pub fn edge_blur_um(&self, defocus_um: f64) -> f64 {
        self.edge_radius_um.hypot(self.edge_slope * defocus_um)
    }

    /// Strength of the bent light at a height of `defocus_um` above the focal plane: zero at the null, opposite signs on
    /// its two sides, fading far from focus.
    pub fn edge_strength(&self, defocus_um: f64) -> f64 {
        let u = (defocus_um - self.edge_null_um) / self.edge_depth_um;
        self.edge_gain * u / (1.0 + u * u)
    }
}

const STEPS: usize = 512;

/// A blurred step: 0 far on one side, 1 far on the other, tabulated over the kernel's support.
#[derive(Debug)]
pub(super) struct EdgeSpread {
    /// Distance, in blur radii, beyond which the step is flat.
    pub support: f64,
    scale: f64,
    table: [f64; STEPS + 2],
}

impl EdgeSpread {
    /// The blurred step at `x` blur radii from the edge.
    #[inline]
    pub fn at(&self, x: f64) -> f64 {
        let u = ((x + self.support) * self.scale).clamp(0.0, STEPS as f64);
        let i = u as usize;
        self.table[i] + (u - i as f64) * (self.table[i + 1] - self.table[i])
    }

    /// A bar of half width `half` blurred over `radius`, at `x` from its middle (all in one unit).
    #[inline]
    pub fn bar(&self, x: f64, half: f64, radius: f64) -> f64 {
        let inverse = 1.0 / radius;
        self.at((x + half) * inverse) - self.at((x - half) * inverse)
    }

    /// A disc of radius `size` blurred over `radius`, at `x` from its centre. Exact where one of the two vanishes; between,
    /// the larger disc with an edge as soft as the smaller.
    #[inline]
    pub fn disc(&self, x: f64, size: f64, radius: f64) -> f64 {
        let (small, large) = if size < radius { (size, radius) } else { (radius, size) };
        let dilution = (size / radius).min(1.0).powi(2);
        dilution * self.at((large - x) / small)
    }

    fn tabulate(support: f64, step: impl Fn(f64) -> f64) -> Self {
        let mut table = [1.0; STEPS + 2];
        for (i, value) in table.iter_mut().enumerate().take(STEPS + 1) {
            *value = step(support * (2.0 * i as f64 / STEPS as f64 - 1.0));
        }
        table[0] = 0.0;
        table[STEPS] = 1.0;
        Self { support, scale: STEPS as f64 / (2.0 * support), table }
    }
}

impl Kernel {
    /// This kernel's blurred step.
    pub(super) fn edge_spread(self) -> &'static EdgeSpread {
        static DISC: LazyLock<EdgeSpread> = LazyLock::new(|| {
            EdgeSpread::tabulate(1.0, |x| 0.5 + (x * (1.0 - x * x).max(0.0).sqrt() + x.clamp(-1.0, 1.0).asin()) / PI)
        });
        // A standard deviation is half a radius; four of them hold all but 6·10⁻⁵.
        static GAUSSIAN: LazyLock<EdgeSpread> = LazyLock::new(|| EdgeSpread::tabulate(2.0, |x| normal_below(2.0 * x)));
        match self {
            Self::Disc => &DISC,
            Self::Gaussian => &GAUSSIAN,
        }
    }
}

/// The share of a standard normal distribution below `x`, by its power series (Marsaglia 2004): exact to 1e-12 for |x| < 6.
pub(super) fn normal_below(x: f64) -> f64 {
    let (mut term, mut sum, mut n) = (x, x, 1.0);
    while term.abs() > 1e-15 {
        n += 2.0;
        term *= x * x / n;
        sum += term;
    }
    0.5 + sum * (-0.5 * x * x).exp() / (2.0 * PI).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blurred_step_is_the_integral_of_its_kernel() {
        // The disc's line spread is a half ellipse; integrated numerically it must give the same step.
        let spread = Kernel::Disc.edge_spread();
        let n = 20_000;
        for x in [-0.9, -0.4, 0.0, 0.3, 0.8] {
            let width = (x + 1.0) / f64::from(n);
            let sum: f64 = (0..n).map(|i| -1.0 + (f64::from(i) + 0.5) * width).map(|u| (1.0 - u * u).sqrt()).sum();
            assert!((spread.at(x) - sum * width * 2.0 / PI).abs() < 1e-4, "{x}");
        }
        assert!((normal_below(1.0) - 0.841_344_746).abs() < 1e-9);
    }

    #[test]
    fn flat_beyond_the_support() {
        for kernel in [Kernel::Disc, Kernel::Gaussian] {
            let spread = kernel.edge_spread();
            assert_eq!((spread.at(-spread.support), spread.at(-9.0)), (0.0, 0.0));
            assert_eq!((spread.at(spread.support), spread.at(9.0)), (1.0, 1.0));
        }
    }

    #[test]
    fn ten_micrometres_of_defocus_blur_over_23_pixels() {
        let radius_px = Optics::WATER_40X.body_blur_um(10.0) / 0.32;
        assert!((22.0..25.0).contains(&radius_px), "{radius_px}");
    }
}
