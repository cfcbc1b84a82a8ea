//! Finds the tip of a micropipette in a picture.
//!
//! In steps, coarse to fine: the lamp's light is taken away ([`light`]); places from which one sector of the picture differs
//! from all others are looked for ([`search`]); a cone, blurred by its depth, is fitted there ([`fit`], [`model`]); how much it
//! explains at every distance says how sure it is ([`verify`], [`hypothesis`]); where the pipette is seen sharply, the place
//! where its detail ends settles the tip ([`end`]). `docs/tips.md` says how well it does.

mod drawn;
mod end;
mod fit;
mod hypothesis;
mod light;
mod model;
pub mod motion;
mod optics;
mod patch;
mod pyramid;
mod search;
mod verify;
mod weights;

use crate::picture::View;
use hypothesis::Hypothesis;
use model::Cone;
use pyramid::Level;
use std::f64::consts::TAU;

/// A micropipette's tip in a picture.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Tip {
    /// Column of the centre of the opening's rim, px; (0, 0) is the centre of the top-left pixel.
    pub x_px: f64,
    /// Row of it, px.
    pub y_px: f64,
    /// Direction in which the tip points (from the shank to the tip), from x (right) towards y (down), -180 … 180 degrees.
    pub angle_deg: f64,
    /// How sure the detector is, 0 to 1.
    pub confidence: f64,
    /// Blur radius of the tip's glass, px: 0 in focus, positive for a tip above the focal plane, negative for one below.
    #[serde(skip)]
    pub blur_px: f64,
}

/// What is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expect {
    /// The direction in which the tip points, degrees as in [`Tip::angle_deg`]; `None`: any.
    pub angle_deg: Option<f64>,
    /// How far from it a pipette may point, degrees.
    pub tolerance_deg: f64,
    /// Less sure tips are not reported.
    pub confidence: f64,
    /// Size of a pixel at the sample, µm: says how wide a pipette's opening and its blur are in the picture.
    pub pixel_um: f64,
}

/// Pixel size that the detector's lengths are meant for, µm.
const PIXEL_UM: f64 = 0.32;

/// A pixel size within this share of [`PIXEL_UM`] is as good as it.
const ALIKE: f64 = 0.02;

/// The largest pixels and the smallest that are told from [`PIXEL_UM`], as a factor.
const EXTREMES: [f64; 2] = [0.5, 16.0];

/// Halvings of a picture at most.
const HALVINGS: f64 = 4.0;

impl Default for Expect {
    fn default() -> Self {
        Self { angle_deg: None, tolerance_deg: 30.0, confidence: 0.5, pixel_um: PIXEL_UM }
    }
}

impl Expect {
    /// How many pixels of the picture a pixel of [`PIXEL_UM`] is wide.
    fn side(&self) -> f64 {
        let side = PIXEL_UM / self.pixel_um;
        if !side.is_finite() || (side - 1.0).abs() < ALIKE { 1.0 } else { side.clamp(EXTREMES[0], EXTREMES[1]) }
    }

    /// How often a picture is halved until its pixels are near to [`PIXEL_UM`].
    fn halvings(&self) -> usize {
        let times = (PIXEL_UM / self.pixel_um).log2().round();
        if times > 0.0 { times.min(HALVINGS) as usize } else { 0 }
    }

    /// What it adds to the logarithm of the odds that something points where it is expected to: false tips point anywhere.
    fn log_odds(&self) -> f64 {
        let share = if self.angle_deg.is_some() { self.tolerance_deg / 180.0 } else { 1.0 };
        -share.clamp(0.02, 1.0).ln()
    }

    fn allows(&self, angle_rad: f64) -> bool {
        self.angle_deg.is_none_or(|expected| {
            let turn = (angle_rad - expected.to_radians() + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
            turn.abs() <= self.tolerance_deg.to_radians()
        })
    }
}

/// Candidates that get a first look, and those that get a closer one.
const CANDIDATES: usize = 40;
const CLOSER: usize = 3;

/// The tip in a picture, or `None` if there is none that the detector is sure of. Works in focus and within 10 µm of it (at
/// 0.32 µm/px and NA 0.8), for dark and bright pipettes, on 8- and 16-bit pictures.
pub fn detect(view: &View<'_>, expect: &Expect) -> Option<Tip> {
    look(view, expect, 1, light::noise).pop()
}

/// Every tip in a picture, the surest first.
pub fn detect_all(view: &View<'_>, expect: &Expect) -> Vec<Tip> {
    let mut tips = look(view, expect, CLOSER, light::noise);
    tips.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
    tips
}

/// The `most` likeliest places of a tip, settled; those that the detector is sure of.
fn look(view: &View<'_>, expect: &Expect, most: usize, noise: fn(&Level) -> f64) -> Vec<Tip> {
    let scale = expect.side();
    let mut levels = pyramid::levels(view, scale);
    let (width, height) = (view.width() as f64 / scale, view.height() as f64 / scale);
    let Some(coarsest) = levels.last() else { return Vec::new() };
    if width.min(height) <= 2.0 * MARGIN_PX {
        return Vec::new();
    }
    let light = light::Light::of(coarsest);
    let noise = noise(&levels[0]).max(f64::MIN_POSITIVE);
    for level in &mut levels {
        light.flatten(level);
    }
    let candidates = search::candidates(&levels, noise, CANDIDATES, |angle| expect.allows(angle));
    let mut found = hypothesis::coarse(&levels, noise, &candidates);
    found.truncate(CLOSER);
    hypothesis::fine(&levels, noise, &found)
        .iter()
        .filter(|h| expect.allows(h.fit.cone.angle) && inside(width, height, h.fit.cone.x, h.fit.cone.y))
        .take(most)
        .map(|h| settle(&levels, h, noise, expect))
        .filter(|tip| tip.confidence >= expect.confidence && inside(width, height, tip.x_px, tip.y_px))
        .map(|tip| Tip {
            x_px: (tip.x_px + 0.5) * scale - 0.5,
            y_px: (tip.y_px + 0.5) * scale - 0.5,
            blur_px: tip.blur_px * scale,
            ..tip
        })
        .collect()
}

/// A tip nearer to the edge than this may as well lie beyond it.
const MARGIN_PX: f64 = 6.0;

fn inside(width: f64, height: f64, x: f64, y: f64) -> bool {
    let within = |v: f64, n: f64| v >= MARGIN_PX && v <= n - 1.0 - MARGIN_PX;
    within(x, width) && within(y, height)
}

/// Detail this far above the noise settles where a pipette ends better than its blur does.
const CLEAR: f64 = 8.0;

/// A sharp end speaks for a pipette: it adds this to the logarithm of the odds.
const SHARP_END: f64 = 3.0;

/// A fit that leaves this many times as much as noise would is of something that the model does not know.
const UNEXPLAINED: f64 = 9.0;

fn settle(levels: &[Level], best: &Hypothesis, noise: f64, expect: &Expect) -> Tip {
    let polished = hypothesis::polish(levels, noise, best);
    let cone = polished.as_ref().map_or(best.fit.cone, |fit| fit.cone);
    // Thin glass bends light more than it takes: a real tip may reach farther than its darkness, which the fit then leaves
    // unexplained, and its detail shows it.
    let laid = || {
        let angle = hypothesis::shank_angle(levels, &best.fit.cone, noise).unwrap_or(best.fit.cone.angle);
        Cone { angle, ..best.fit.cone }
    };
    let end = (best.unexplained > UNEXPLAINED)
        .then(laid)
        .and_then(|axis| end::settled(levels, &axis, noise))
        .filter(|(_, end)| end.clarity > CLEAR);
    let (x, y, angle) = match end {
        Some((axis, end)) => {
            let (sin, cos) = axis.angle.sin_cos();
            (axis.x + end.beyond * cos, axis.y + end.beyond * sin, axis.angle)
        }
        None => (cone.x, cone.y, cone.angle),
    };
    let log_odds = best.log_odds() + expect.log_odds() + if end.is_some() { SHARP_END } else { 0.0 };
    let degrees = angle.to_degrees().rem_euclid(360.0);
    Tip {
        x_px: x,
        y_px: y,
        angle_deg: if degrees > 180.0 { degrees - 360.0 } else { degrees },
        confidence: 1.0 / (1.0 + (-log_odds).exp()),
        blur_px: cone.blur,
    }
}
