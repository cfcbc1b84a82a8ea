//! Finds the tip of a micropipette in a picture.
//!
//! In steps, coarse to fine: the lamp's light is taken away ([`light`]); places from which one sector of the picture differs
//! from all others are looked for ([`search`]); a cone, blurred by its depth, is fitted there ([`fit`], [`model`]); how much it
//! explains at every distance says how sure it is ([`verify`], [`hypothesis`]); where the pipette is seen sharply, the place
//! where its detail ends settles the tip ([`end`]). `docs/tips.md` says how well it does.

mod dual;
mod end;
mod fit;
mod hypothesis;
mod light;
mod model;
pub mod motion;
mod pyramid;
mod search;
mod verify;

use crate::picture::View;
use hypothesis::{FINE, Hypothesis};
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
}

impl Default for Expect {
    fn default() -> Self {
        Self { angle_deg: None, tolerance_deg: 30.0, confidence: 0.5 }
    }
}

impl Expect {
    fn allows(&self, angle_rad: f64) -> bool {
        self.angle_deg.is_none_or(|expected| {
            let turn = (angle_rad - expected.to_radians() + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
            turn.abs() <= self.tolerance_deg.to_radians()
        })
    }
}

/// Candidates that get a first look, and those that get a closer one.
const CANDIDATES: usize = 16;
const CLOSER: usize = 5;

/// The tip in a picture, or `None` if there is none that the detector is sure of. Works in focus and within 10 µm of it (at
/// 0.32 µm/px and NA 0.8), for dark and bright pipettes, on 8- and 16-bit pictures.
pub fn detect(view: &View<'_>, expect: &Expect) -> Option<Tip> {
    let mut levels = pyramid::levels(view);
    let light = light::Light::of(levels.last()?);
    let noise = light::noise(&levels[0]).max(f64::MIN_POSITIVE);
    for level in &mut levels {
        light.flatten(level);
    }
    let candidates = search::candidates(&levels, noise, CANDIDATES, |angle| expect.allows(angle));
    let mut found = hypothesis::coarse(&levels, noise, &candidates);
    found.truncate(CLOSER);
    let best = hypothesis::fine(&levels, noise, &found)
        .into_iter()
        .find(|h| expect.allows(h.fit.cone.angle) && inside(view, h.fit.cone.x, h.fit.cone.y))?;
    let tip = settle(&levels, &best, noise);
    (tip.confidence >= expect.confidence && inside(view, tip.x_px, tip.y_px)).then_some(tip)
}

/// A tip nearer to the edge than this may as well lie beyond it.
const MARGIN_PX: f64 = 6.0;

fn inside(view: &View<'_>, x: f64, y: f64) -> bool {
    let within = |v: f64, n: usize| v >= MARGIN_PX && v <= n as f64 - 1.0 - MARGIN_PX;
    within(x, view.width()) && within(y, view.height())
}

/// Detail this far above the noise settles where a pipette ends better than its blur does.
const CLEAR: f64 = 8.0;

fn settle(levels: &[Level], best: &Hypothesis, noise: f64) -> Tip {
    let cone = &best.fit.cone;
    let end = end::end(levels, cone, noise).filter(|end| end.clarity > CLEAR);
    let beyond = end.map_or(0.0, |end| end.beyond);
    let (sin, cos) = cone.angle.sin_cos();
    let log_odds = best.log_odds(&FINE) + if end.is_some() { 5.5 } else { 0.0 };
    let angle = end.and_then(|_| hypothesis::shank_angle(levels, cone, noise)).unwrap_or(cone.angle);
    let degrees = angle.to_degrees().rem_euclid(360.0);
    Tip {
        x_px: cone.x + beyond * cos,
        y_px: cone.y + beyond * sin,
        angle_deg: if degrees > 180.0 { degrees - 360.0 } else { degrees },
        confidence: 1.0 / (1.0 + (-log_odds).exp()),
    }
}
