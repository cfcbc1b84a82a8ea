//! Where a sharply seen pipette ends along its axis.

use super::model::Cone;
use super::pyramid::Level;

/// The end of the detail along a cone's axis.
#[derive(Clone, Copy, Debug)]
pub struct End {
    /// How far beyond the cone's tip the detail ends, px; negative: before it.
    pub beyond: f64,
    /// Detail over noise: root of the mean squared gradients on the shank, in standard deviations of the noise's.
    pub clarity: f64,
}

/// A cone's axis and the end of the detail along it, looked for again from where it was found: the cone's own tip may lie far
/// behind it, and beside the axis. What the cone says of the opening with it is not asked.
pub fn settled(levels: &[Level], cone: &Cone, noise: f64) -> Option<(Cone, End)> {
    let (sin, cos) = cone.angle.sin_cos();
    let moved = |from: &Cone, beyond: f64| Cone { x: from.x + beyond * cos, y: from.y + beyond * sin, ..*from };
    let mut axis = Cone { ln_opening: OPENING_PX.ln(), ln_widening: WIDENING.ln(), ..*cone };
    let mut found = end(levels, &axis, noise)?;
    for _ in 0..CENTRED {
        let at = moved(&axis, found.beyond);
        let Some(aside) = aside(levels, &at, noise) else { break };
        let centred = Cone { x: at.x - aside * sin, y: at.y + aside * cos, ..axis };
        let Some(next) = end(levels, &centred, noise) else { break };
        (axis, found) = (centred, next);
    }
    for _ in 0..AGAIN {
        // A look that ends elsewhere has followed something else: the seam in front, or dirt.
        let next = end(levels, &moved(&axis, found.beyond), noise).filter(|end| end.beyond.abs() <= OPENING_PX);
        let Some(next) = next else { break };
        found.beyond += next.beyond;
        if next.beyond.abs() < 0.1 {
            break;
        }
    }
    Some((axis, found))
}

/// How often an axis is moved to the middle of the detail that lies about it.
const CENTRED: usize = 2;

/// How far up the shank that middle is taken from, px.
const LAST_PX: f64 = 16.0;

/// How far beside a tip's axis the middle of the detail lies on the last of the shank, px.
fn aside(levels: &[Level], tip: &Cone, noise: f64) -> Option<f64> {
    let level = levels.first()?;
    let step = level.step as f64;
    let floor = noise / step;
    let n = (2.0 * ASIDE_PX) as i32;
    let (mut sum, mut moment) = (0.0, 0.0);
    for i in -n..=n {
        let t = 0.5 * f64::from(i);
        let along = (0..).map(|k| f64::from(k) * step).take_while(|s| *s < LAST_PX);
        let held: Vec<f64> = along.filter_map(|s| detail(level, tip, step, floor, s, t)).collect();
        let mean = held.iter().sum::<f64>() / held.len().max(1) as f64;
        // The root of a gradient: the clearer of the two walls would draw the middle to itself.
        let size = mean.max(0.0).sqrt().sqrt();
        sum += size;
        moment += t * size;
    }
    (sum > 0.0).then(|| moment / sum)
}

/// How far beside the axis detail is looked at, px.
const ASIDE_PX: f64 = 10.0;

/// The squared gradient, less that of noise, at `s` along the shank and `t` aside.
fn detail(level: &Level, cone: &Cone, step: f64, floor: f64, s: f64, t: f64) -> Option<f64> {
    let (sin, cos) = cone.angle.sin_cos();
    let at = |s: f64, t: f64| level.between(cone.x - s * cos - t * sin, cone.y - s * sin + t * cos);
    let along = at(s + step, t)? - at(s - step, t)?;
    let across = at(s, t + step)? - at(s, t - step)?;
    Some(along * along + across * across - 4.0 * floor * floor)
}

/// Looks after the first, at most.
const AGAIN: usize = 3;

/// Radius of an opening whose end is looked for, px, and what its outline's half width gains per px.
const OPENING_PX: f64 = 3.0;
const WIDENING: f64 = 0.2;

/// Detail begins where it is this share of the shank's. The light bent in front of a rim makes up to a third of it.
const BEGINS: f64 = 0.37;

/// Looks for the place where the gradients of glass and halo fall to half of what they are along the last part of the shank.
/// `noise` is a standard deviation of a pixel of the picture.
pub fn end(levels: &[Level], cone: &Cone, noise: f64) -> Option<End> {
    let (opening, widening) = (cone.ln_opening.exp(), cone.ln_widening.exp());
    let unit = (0.3 * opening).clamp(1.0, 6.0);
    let level = levels.iter().rev().find(|l| l.step as f64 <= unit).unwrap_or(&levels[0]);
    let floor = noise / level.step as f64;
    let step = unit.max(level.step as f64);
    let energy = |s: f64| -> Option<f64> {
        let half = opening + widening * s.max(0.0) + 2.0 * step;
        let n = (half / step).ceil() as i32;
        let held: Vec<f64> =
            (-n..=n).filter_map(|i| detail(level, cone, step, floor, s, f64::from(i) * step)).collect();
        let mean = held.iter().sum::<f64>() / (held.len().max(1) as f64);
        (held.len() >= n as usize).then(|| mean.max(0.0).sqrt())
    };
    // From well on the shank outwards.
    let back = (8.0 * opening).clamp(12.0, 60.0);
    let profile: Vec<(f64, f64)> = (0..)
        .map(|i| back - f64::from(i) * 0.5 * step)
        .take_while(|s| *s > -1.5 * back)
        .map_while(|s| Some((s, energy(s)?)))
        .collect();
    let mut shank: Vec<f64> = profile.iter().filter(|(s, _)| *s > 0.0).map(|p| p.1).collect();
    if shank.len() < 4 {
        return None;
    }
    shank.sort_by(f64::total_cmp);
    let clarity = shank[shank.len() * 3 / 4] / (2.0 * floor).max(f64::MIN_POSITIVE);
    // Where bent light changes its sign, a shank may lack detail for a bit.
    let quiet = 4.0 * opening;
    // First where detail begins at all, then where it is half of what it is just behind.
    let first = fall(&profile, BEGINS * shank[shank.len() * 3 / 4], quiet)?;
    let width = (opening + widening * first).max(0.5 * opening);
    let near: Vec<f64> = profile.iter().filter(|p| p.0 > first && p.0 < first + 1.8 * width).map(|p| p.1).collect();
    let plateau = near.iter().sum::<f64>() / (near.len().max(1) as f64);
    // The rim's centre lies behind the outer edge of its halo.
    let tip = fall(&profile, 0.5 * plateau, quiet)? + 0.4 * width;
    Some(End { beyond: -tip, clarity })
}

/// The place where a profile falls below a limit and stays there for `quiet` px.
fn fall(profile: &[(f64, f64)], limit: f64, quiet: f64) -> Option<f64> {
    (0..profile.len().saturating_sub(1)).find_map(|i| {
        let (a, b) = (profile[i], profile[i + 1]);
        let calm = profile[i + 1..].iter().take_while(|p| p.0 > a.0 - quiet).all(|p| p.1 < limit);
        (a.1 >= limit && calm).then(|| a.0 + (a.1 - limit) / (a.1 - b.1) * (b.0 - a.0))
    })
}
