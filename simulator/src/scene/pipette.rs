//! A micropipette: a hollow glass cone that leans into the picture, its tip the lowest point.

use super::Viewpoint;
use super::optics::{EdgeSpread, Optics};
use super::paint::Object;
use std::f64::consts::FRAC_PI_4;

/// Radius of the lumen over that of the glass. Fitted to a real tip (`docs/tips.md`).
const LUMEN_RATIO: f64 = 0.508;

/// How much of the glass's darkness the lumen lacks. Fitted to a real tip (`docs/tips.md`).
const LUMEN_BRIGHTNESS: f64 = 0.524;

/// One micropipette. Lengths are µm in ref (z up), angles rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pipette {
    /// The centre of the opening's rim.
    pub tip_um: [f64; 3],
    /// Direction in which the tip points, seen from above: from ref's x axis towards its y axis.
    pub azimuth_rad: f64,
    /// How steeply it descends to its tip; 0 would lie flat.
    pub descent_rad: f64,
    /// Outer radius of the opening.
    pub opening_radius_um: f64,
    /// Half of the cone's full angle.
    pub half_angle_rad: f64,
    /// How much of the light the glass takes, in focus; negative for a bright pipette.
    pub contrast: f64,
}

impl Pipette {
    /// The unit vector along the pipette, to the tip.
    pub fn direction(&self) -> [f64; 3] {
        let (descent, azimuth) = (self.descent_rad, self.azimuth_rad);
        [descent.cos() * azimuth.cos(), descent.cos() * azimuth.sin(), -descent.sin()]
    }
}

/// A pipette as one viewpoint sees it. Distances along it (`s`) are measured in the plan, from the tip to the shank.
pub(super) struct Projection {
    tip_um: [f64; 2],
    towards_tip: [f64; 2],
    /// Height of the tip above the focal plane, and how much higher each µm along the shank lies.
    tip_height_um: f64,
    rise: f64,
    opening_um: f64,
    widening: f64,
    /// Half of the rim's extent along the pipette: it is a circle seen at a slant.
    rim_um: f64,
    contrast: f64,
    optics: Optics,
    spread: &'static EdgeSpread,
}

impl Projection {
    pub fn new(pipette: &Pipette, view: &Viewpoint) -> Self {
        let [x, y, z] = pipette.tip_um;
        Self {
            tip_um: [x, y],
            towards_tip: [pipette.azimuth_rad.cos(), pipette.azimuth_rad.sin()],
            tip_height_um: z - view.focus_um,
            rise: pipette.descent_rad.tan(),
            opening_um: pipette.opening_radius_um,
            widening: pipette.half_angle_rad.tan() / pipette.descent_rad.cos(),
            rim_um: pipette.opening_radius_um * pipette.descent_rad.sin(),
            contrast: pipette.contrast,
            optics: view.optics,
            spread: view.optics.kernel.edge_spread(),
        }
    }

    /// Distances from the tip along the shank and across it.
    #[inline]
    fn along_across(&self, [x, y]: [f64; 2]) -> (f64, f64) {
        let [dx, dy] = [x - self.tip_um[0], y - self.tip_um[1]];
        let [ux, uy] = self.towards_tip;
        (-(dx * ux + dy * uy), dy * ux - dx * uy)
    }

    #[inline]
    fn height_um(&self, s: f64) -> f64 {
        self.tip_height_um + s.max(0.0) * self.rise
    }

    #[inline]
    fn half_width_um(&self, s: f64) -> f64 {
        self.opening_um + s.max(0.0) * self.widening
    }

    fn widest_blur_um(&self, s: f64) -> f64 {
        let height = self.height_um(s);
        let body = self.optics.body_blur_um(height);
        body.max(self.optics.edge_blur_um(height) * self.optics.edge_spread.max(1.0)) * self.spread.support
    }
}

impl Object for Projection {
    fn touches(&self, at_um: [f64; 2], reach_um: f64) -> bool {
        let (s, t) = self.along_across(at_um);
        let blur = self.widest_blur_um(s - reach_um).max(self.widest_blur_um(s + reach_um));
        s + reach_um > -(self.rim_um + blur) && t.abs() - reach_um < self.half_width_um(s + reach_um) + blur
    }

    fn finest_um(&self, at_um: [f64; 2], reach_um: f64) -> f64 {
        let (s, t) = self.along_across(at_um);
        let (low, high) = (self.height_um(s - reach_um), self.height_um(s + reach_um));
        let height = if low <= 0.0 && high >= 0.0 { 0.0 } else { low.abs().min(high.abs()) };
        let (body, edge) = (self.optics.body_blur_um(height), self.optics.edge_blur_um(height));
        // Bent light stays near the outline, where it is sharper than the body.
        let seam = reach_um
            + self.spread.support * self.optics.edge_spread * self.optics.edge_blur_um(low.abs().max(high.abs()));
        let outline = self.half_width_um(s - reach_um) - seam..self.half_width_um(s + reach_um) + seam;
        if s < seam || outline.contains(&t.abs()) { body.min(edge) } else { body }
    }

    #[inline]
    fn contrast(&self, at_um: [f64; 2]) -> f64 {
        let (s, t) = self.along_across(at_um);
        let height = self.height_um(s);
        let half = self.half_width_um(s);
        let (body, edge) = (self.optics.body_blur_um(height), self.optics.edge_blur_um(height));
        let spread = self.spread;
        let bar = |half: f64, blur: f64| spread.bar(t, half, blur);
        // The outline ends at the rim's far side, an ellipse about the tip; a blur wider than the rim sees all of it at once.
        let here = (1.0 - (t / self.opening_um).powi(2)).max(0.0).sqrt();
        let end = |blur: f64| {
            let sharp = 1.0 / (1.0 + (blur / self.opening_um).powi(2));
            spread.at((s + self.rim_um * (sharp * here + (1.0 - sharp) * FRAC_PI_4)) / blur)
        };
        let glass = (bar(half, body) - LUMEN_BRIGHTNESS * bar(LUMEN_RATIO * half, body)) * end(body);
        let wide = edge * self.optics.edge_spread;
        let seam = (bar(half, edge) - bar(half, wide)) * end(edge);
        self.contrast * (self.optics.edge_strength(height) * seam - glass)
    }
}
