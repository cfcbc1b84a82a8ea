//! Random scenes, drawn from ranges.

use super::{Exposure, Kernel, Light, Matter, Optics, Pipette, Scene, Speck, Viewpoint};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::Deserialize;
use std::f64::consts::TAU;

/// From which ranges (lowest, highest) scenes are drawn, evenly. A file may hold it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ranges {
    /// Columns and rows.
    pub picture_px: [usize; 2],
    /// Bits of a grey value.
    pub bits: u32,
    /// Pixel size at the sample.
    pub pixel_um: f64,
    /// A tip lies at least this far from the picture's edge.
    pub margin_px: f64,
    /// How far a tip that is not to be seen lies outside the picture.
    pub outside_px: [f64; 2],
    /// Height of the focal plane above the tip.
    pub focus_um: [f64; 2],
    /// How steeply pipettes descend.
    pub descent_deg: [f64; 2],
    /// Half of their cone's angle.
    pub half_angle_deg: [f64; 2],
    /// Outer radius of their opening.
    pub opening_radius_um: [f64; 2],
    /// Light that pipettes, cells and debris take.
    pub contrast: [f64; 2],
    /// Share of pipettes and debris that are brighter than the field instead of darker.
    pub bright_share: f64,
    /// Light bent at a wall, as a factor to the real objective's.
    pub edge_factor: [f64; 2],
    /// Noise of an empty field, as a share of its grey value.
    pub noise: [f64; 2],
    /// Number of cells and debris.
    pub specks: [usize; 2],
    /// Radius of cells.
    pub cell_radius_um: [f64; 2],
    /// Radius of debris.
    pub debris_radius_um: [f64; 2],
    /// Height of cells and debris above the focal plane.
    pub speck_height_um: [f64; 2],
    /// Grey value of an empty field, as a share of full scale.
    pub level: [f64; 2],
    /// Share of the light lost in the corners.
    pub vignetting: [f64; 2],
    /// Largest relative rise of the light from the middle to an edge.
    pub slope: f64,
}

/// What a random scene shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Show {
    /// One pipette, its tip in the picture.
    Tip,
    /// Two pipettes from different sides.
    TwoTips,
    /// One pipette whose tip lies outside the picture.
    ShankOnly,
    /// No pipette.
    Nothing,
}

/// A random scene and what is true of it.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// What there is.
    pub scene: Scene,
    /// Where it is seen from.
    pub view: Viewpoint,
    /// How it is exposed.
    pub exposure: Exposure,
    /// The pipettes as they appear in the picture, in the scene's order.
    pub seen: Vec<Seen>,
}

/// A pipette in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Its tip, px.
    pub tip_px: [f64; 2],
    /// Direction in which it points, from x (right) towards y (down), degrees.
    pub angle_deg: f64,
}

impl Ranges {
    /// The scene numbered `seed`: the same for the same ranges, always.
    pub fn draw(&self, show: Show, seed: u64) -> Drawn {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let [width, height] = self.picture_px;
        let factor = self.within(&mut rng, self.edge_factor);
        let kernel = if rng.random_bool(0.5) { Kernel::Disc } else { Kernel::Gaussian };
        let optics = Optics { edge_gain: factor * Optics::WATER_40X.edge_gain, kernel, ..Optics::WATER_40X };
        let view = Viewpoint {
            bits: self.bits,
            optics,
            ..Viewpoint::level([0.0, 0.0], self.within(&mut rng, self.focus_um), self.pixel_um, width, height)
        };
        let count = match show {
            Show::Nothing => 0,
            Show::Tip | Show::ShankOnly => 1,
            Show::TwoTips => 2,
        };
        let mut scene = Scene { light: self.light(&mut rng), ..Scene::default() };
        let mut seen = Vec::new();
        for i in 0..count {
            let (tip_px, mut angle) = match show {
                Show::ShankOnly => self.tip_outside(&mut rng),
                _ => (self.tip_inside(&mut rng), rng.random_range(0.0..TAU)),
            };
            if i > 0 {
                // From another side than the first.
                let first: Seen = seen[0];
                angle = first.angle_deg.to_radians() + self.within(&mut rng, [0.25 * TAU, 0.75 * TAU]);
            }
            let pipette = self.pipette(&mut rng, &view, tip_px, angle);
            scene.pipettes.push(pipette);
            seen.push(Seen { tip_px, angle_deg: angle.to_degrees() });
        }
        for _ in 0..rng.random_range(self.specks[0]..=self.specks[1]) {
            scene.specks.push(self.speck(&mut rng, &view));
        }
        let level = self.within(&mut rng, self.level);
        let noise = self.within(&mut rng, self.noise);
        // A twentieth of the noise's power is the camera's own.
        let exposure = Exposure {
            level,
            shot_noise: noise * 0.95_f64.sqrt(),
            read_noise: noise * level * 0.05_f64.sqrt(),
            seed: rng.random(),
        };
        Drawn { scene, view, exposure, seen }
    }

    fn within(&self, rng: &mut Pcg64Mcg, [low, high]: [f64; 2]) -> f64 {
        if low < high { rng.random_range(low..=high) } else { low }
    }

    fn light(&self, rng: &mut Pcg64Mcg) -> Light {
        let slope = [-self.slope, self.slope];
        Light {
            vignetting: self.within(rng, self.vignetting),
            slope: [self.within(rng, slope), self.within(rng, slope)],
        }
    }

    fn tip_inside(&self, rng: &mut Pcg64Mcg) -> [f64; 2] {
        self.picture_px.map(|n| {
            let margin = self.margin_px.min(0.5 * n as f64 - 1.0);
            self.within(rng, [margin, n as f64 - 1.0 - margin])
        })
    }

    /// A tip outside the picture, whose shank crosses it.
    fn tip_outside(&self, rng: &mut Pcg64Mcg) -> ([f64; 2], f64) {
        let inside = self.tip_inside(rng);
        let angle = rng.random_range(0.0..TAU);
        let [ux, uy] = [angle.cos(), angle.sin()];
        let [w, h] = self.picture_px.map(|n| n as f64);
        let to_edge = |at: f64, u: f64, n: f64| if u > 0.0 { (n - at) / u } else { at / -u };
        let way = to_edge(inside[0], ux, w).min(to_edge(inside[1], uy, h)) + self.within(rng, self.outside_px);
        ([inside[0] + way * ux, inside[1] + way * uy], angle)
    }

    fn signed(&self, rng: &mut Pcg64Mcg) -> f64 {
        let contrast = self.within(rng, self.contrast);
        if rng.random_bool(self.bright_share) { -contrast } else { contrast }
    }

    fn pipette(&self, rng: &mut Pcg64Mcg, view: &Viewpoint, tip_px: [f64; 2], angle: f64) -> Pipette {
        let [x, y] = view.ref_um(tip_px[0], tip_px[1]);
        let [x1, y1] = view.ref_um(tip_px[0] + angle.cos(), tip_px[1] + angle.sin());
        Pipette {
            tip_um: [x, y, 0.0],
            azimuth_rad: (y1 - y).atan2(x1 - x),
            descent_rad: self.within(rng, self.descent_deg).to_radians(),
            opening_radius_um: self.within(rng, self.opening_radius_um),
            half_angle_rad: self.within(rng, self.half_angle_deg).to_radians(),
            contrast: self.signed(rng),
        }
    }

    fn speck(&self, rng: &mut Pcg64Mcg, view: &Viewpoint) -> Speck {
        let place = self.picture_px.map(|n| rng.random_range(0.0..n as f64));
        let [x, y] = view.ref_um(place[0], place[1]);
        let z = view.focus_um + self.within(rng, self.speck_height_um);
        let cell = rng.random_bool(0.5);
        let radius = if cell { self.cell_radius_um } else { self.debris_radius_um };
        Speck {
            matter: if cell { Matter::Cell } else { Matter::Debris },
            at_um: [x, y, z],
            radius_um: self.within(rng, radius),
            aspect: rng.random_range(1.0..2.5),
            azimuth_rad: rng.random_range(0.0..TAU),
            contrast: self.signed(rng),
        }
    }
}
