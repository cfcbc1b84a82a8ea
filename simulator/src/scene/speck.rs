//! Whatever else lies in a dish: cells and debris.

use super::Viewpoint;
use super::optics::{EdgeSpread, Optics};
use super::paint::Object;

/// What a speck is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Matter {
    /// An unstained cell: its membrane bends light, its inside takes little.
    Cell,
    /// Dirt that takes light.
    Debris,
}

/// A cell or a piece of debris: an ellipse at a height of its own. Lengths are µm in ref (z up).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speck {
    /// What it is made of.
    pub matter: Matter,
    /// Its centre.
    pub at_um: [f64; 3],
    /// Its radius, the geometric mean of the ellipse's two.
    pub radius_um: f64,
    /// Long over short radius, at least 1.
    pub aspect: f64,
    /// Direction of the long radius from ref's x axis towards its y axis.
    pub azimuth_rad: f64,
    /// How much of the light it takes in focus; negative for a bright one.
    pub contrast: f64,
}

/// Thickness of a membrane's bent light over the cell's radius.
const MEMBRANE: f64 = 0.15;

/// Light taken by a cell's inside, over that bent by its membrane.
const CYTOPLASM: f64 = 0.3;

/// A speck as one viewpoint sees it.
pub(super) struct Projection {
    centre_um: [f64; 2],
    long_axis: [f64; 2],
    /// Scales of the long and the short axis that make the ellipse a circle of its mean radius.
    squeeze: [f64; 2],
    radius_um: f64,
    blur_um: f64,
    inside: f64,
    membrane: f64,
    spread: &'static EdgeSpread,
}

impl Projection {
    pub fn new(speck: &Speck, view: &Viewpoint) -> Self {
        let optics: &Optics = &view.optics;
        let height = speck.at_um[2] - view.focus_um;
        let stretch = speck.aspect.max(1.0).sqrt();
        let (inside, membrane, blur_um) = match speck.matter {
            Matter::Cell => (-CYTOPLASM * speck.contrast, speck.contrast, optics.edge_blur_um(height)),
            Matter::Debris => (-speck.contrast, 0.0, optics.body_blur_um(height)),
        };
        // Bent light is measured against its strongest, so that `contrast` is what the eye sees of a cell.
        let bent = optics.edge_strength(height) / (0.5 * optics.edge_gain.abs()).max(f64::MIN_POSITIVE);
        Self {
            centre_um: [speck.at_um[0], speck.at_um[1]],
            long_axis: [speck.azimuth_rad.cos(), speck.azimuth_rad.sin()],
            squeeze: [1.0 / stretch, stretch],
            radius_um: speck.radius_um,
            blur_um,
            inside,
            membrane: membrane * bent,
            spread: optics.kernel.edge_spread(),
        }
    }

    /// Whether blur has spread the speck so thin that no camera sees it.
    fn faint(&self) -> bool {
        let dilution = (self.radius_um / self.blur_um).min(1.0).powi(2);
        dilution * (self.inside.abs() + self.membrane.abs()) < 3e-4
    }

    fn distance_um(&self, [x, y]: [f64; 2]) -> f64 {
        let [dx, dy] = [x - self.centre_um[0], y - self.centre_um[1]];
        let [ux, uy] = self.long_axis;
        ((dx * ux + dy * uy) * self.squeeze[0]).hypot((dy * ux - dx * uy) * self.squeeze[1])
    }
}

impl Object for Projection {
    fn touches(&self, at_um: [f64; 2], reach_um: f64) -> bool {
        if self.faint() {
            return false;
        }
        let limit = self.radius_um + self.blur_um * self.spread.support * (1.0 + MEMBRANE);
        // The squeezed distance shrinks by at most the long axis's scale.
        self.distance_um(at_um) - reach_um * self.squeeze[1] < limit
    }

    fn finest_um(&self, _at_um: [f64; 2], _reach_um: f64) -> f64 {
        self.blur_um.min(self.radius_um * (1.0 - MEMBRANE))
    }

    fn contrast(&self, at_um: [f64; 2]) -> f64 {
        let distance = self.distance_um(at_um);
        let disc = |size: f64| self.spread.disc(distance, size, self.blur_um);
        let whole = disc(self.radius_um);
        let mut contrast = self.inside * whole;
        if self.membrane != 0.0 {
            let ring = disc(self.radius_um * (1.0 + MEMBRANE)) - disc(self.radius_um * (1.0 - MEMBRANE));
            contrast += self.membrane * ring;
        }
        contrast
    }
}
