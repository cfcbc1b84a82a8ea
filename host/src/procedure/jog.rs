//! A pipette told from everything else by moving it: what changed between two frames is the pipette, in focus or not.
//!
//! The difference of the two frames is smoothed and held against its own noise; the largest connected part that changed is of the pipette, where
//! it was or where it is. What also changed one jog further is where it is, and its end in the direction that the pipette points in is
//! the tip. Blur makes the end uncertain by its radius, thinness hides the last stretch of a tip at low magnification: enough to
//! come closer, not to calibrate.

use super::point::FramePixel;
use crate::picture::{Data, Picture};
use nalgebra::Vector2;

/// What moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Jogged {
    /// A pipette whose tip is in the picture.
    Tip(FramePixel),
    /// A pipette that leaves the picture on the side where its tip is; the place where it leaves.
    Beyond(FramePixel),
}

impl Jogged {
    /// The last place of the pipette that the picture shows.
    pub fn at(self) -> FramePixel {
        let (Self::Tip(at) | Self::Beyond(at)) = self;
        at
    }
}

/// Half of the smoothing window's side, px.
const HALF: usize = 4;
/// A smoothed difference counts from this many of its standard deviations on.
const SIGMAS: f64 = 6.0;
/// A pipette covers at least this share of the shorter side, squared.
const LEAST_SHARE: f64 = 0.05;
/// An end this near to the border is not the tip's, px.
const BORDER_PX: f64 = 3.0 + HALF as f64;

/// The pipette in the second of two frames, of which the first was taken after a sideways jog that displaced it by `jog_px` in the picture.
/// `towards` is where the tip points, in the picture. `None` when nothing moved that is as large as a pipette.
pub fn jogged(jogged: &Picture, here: &Picture, jog_px: Vector2<f64>, towards: Vector2<f64>) -> Option<Jogged> {
    let (w, h) = (here.width, here.height);
    let towards = towards.try_normalize(1e-9)?;
    if (jogged.width, jogged.height) != (w, h) || w <= 4 * HALF || h <= 4 * HALF {
        return None;
    }
    let difference: Vec<f32> = values(jogged).zip(values(here)).map(|(a, b)| a - b).collect();
    // The light may have changed between the two.
    let middle = median(&difference);
    let noise = 1.4826 * median(&difference.iter().map(|d| (d - middle).abs()).collect::<Vec<_>>());
    let smooth = smoothed(&difference, w, h);
    let side = (2 * HALF + 1) as f64;
    let limit = (SIGMAS * f64::from(noise).max(1e-3) / side) as f32;
    let changed: Vec<bool> = smooth.iter().map(|d| (d - middle).abs() > limit).collect();
    let part = largest(&changed, w, h);
    let least = (LEAST_SHARE * w.min(h) as f64).powi(2);
    if (part.len() as f64) < least {
        return None;
    }
    let mut in_part = vec![false; changed.len()];
    part.iter().for_each(|i| in_part[*i] = true);
    // Both of the pipette's places changed, often as two parts: it is now where one jog further changed too.
    let (dx, dy) = (jog_px.x.round() as isize, jog_px.y.round() as isize);
    let is_now = |i: usize| {
        let (x, y) = ((i % w) as isize + dx, (i / w) as isize + dy);
        let inside = (0..w as isize).contains(&x) && (0..h as isize).contains(&y);
        if !inside {
            // Beyond the border nobody knows.
            return in_part[i];
        }
        let further = y as usize * w + x as usize;
        changed[i] && changed[further] && (in_part[i] || in_part[further])
    };
    let now: Vec<usize> = (0..changed.len()).filter(|i| is_now(*i)).collect();
    if now.is_empty() {
        return None;
    }
    let place = |i: usize| Vector2::new((i % w) as f64, (i / w) as f64);
    let mut along: Vec<(f64, usize)> = now.iter().map(|i| (place(*i).dot(&towards), *i)).collect();
    along.sort_by(|a, b| b.0.total_cmp(&a.0));
    // The very end is noise and smoothing: the tip is where the first few pixels are, half a window behind them.
    let first = &along[..(along.len() / 200).clamp(8, 40).min(along.len())];
    let end = first.iter().map(|(_, i)| place(*i)).sum::<Vector2<f64>>() / first.len() as f64;
    let (right, bottom) = (w as f64 - 1.0 - BORDER_PX, h as f64 - 1.0 - BORDER_PX);
    let inside = (BORDER_PX..right).contains(&end.x) && (BORDER_PX..bottom).contains(&end.y);
    let tip = end - towards * HALF as f64;
    let at = |p: Vector2<f64>| FramePixel { x_px: p.x, y_px: p.y };
    Some(if inside { Jogged::Tip(at(tip)) } else { Jogged::Beyond(at(tip)) })
}

fn values(picture: &Picture) -> Box<dyn Iterator<Item = f32> + '_> {
    match &picture.data {
        Data::Grey8(data) => Box::new(data.iter().map(|v| f32::from(*v))),
        Data::Grey16(data) => Box::new(data.iter().map(|v| f32::from(*v))),
    }
}

fn median(values: &[f32]) -> f32 {
    let mut values = values.to_vec();
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Means over windows, by sums of columns and rows; windows shrink at the borders.
fn smoothed(values: &[f32], w: usize, h: usize) -> Vec<f32> {
    let mut sums = vec![0.0f64; (w + 1) * (h + 1)];
    for y in 0..h {
        let mut row = 0.0;
        for x in 0..w {
            row += f64::from(values[y * w + x]);
            sums[(y + 1) * (w + 1) + x + 1] = sums[y * (w + 1) + x + 1] + row;
        }
    }
    let at = |x: usize, y: usize| sums[y * (w + 1) + x];
    (0..w * h)
        .map(|i| {
            let (x, y) = (i % w, i / w);
            let (left, top) = (x.saturating_sub(HALF), y.saturating_sub(HALF));
            let (right, bottom) = ((x + HALF + 1).min(w), (y + HALF + 1).min(h));
            let sum = at(right, bottom) - at(left, bottom) - at(right, top) + at(left, top);
            (sum / ((right - left) * (bottom - top)) as f64) as f32
        })
        .collect()
}

/// The pixels of the largest connected part. Gaps as wide as the window do not part a pipette from its own other edge.
fn largest(mask: &[bool], w: usize, h: usize) -> Vec<usize> {
    let mut seen = vec![false; mask.len()];
    let mut best = Vec::new();
    for start in 0..mask.len() {
        if !mask[start] || seen[start] {
            continue;
        }
        seen[start] = true;
        let mut part = vec![start];
        let mut next = 0;
        while next < part.len() {
            let (x, y) = (part[next] % w, part[next] / w);
            next += 1;
            for v in y.saturating_sub(2)..(y + 3).min(h) {
                for u in x.saturating_sub(2)..(x + 3).min(w) {
                    let i = v * w + u;
                    if mask[i] && !seen[i] {
                        seen[i] = true;
                        part.push(i);
                    }
                }
            }
        }
        if part.len() > best.len() {
            best = part;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use parfocal_simulator::scene::{Exposure, Light, Optics, Pipette, Scene, Viewpoint};

    const PIXEL_UM: f64 = 0.32;

    /// A pipette pointing in `azimuth`, its tip at px, `defocus_um` above focus; frames before and after the jog back.
    fn frames(tip_px: [f64; 2], azimuth: f64, defocus_um: f64, jog_um: [f64; 2], seed: u64) -> [Picture; 2] {
        let view = Viewpoint { optics: Optics::WATER_40X, ..Viewpoint::level([0.0, 0.0], 0.0, PIXEL_UM, 640, 480) };
        let [x, y] = view.ref_um(tip_px[0], tip_px[1]);
        let picture = |shift: [f64; 2], seed| {
            let pipette = Pipette {
                tip_um: [x + shift[0], y + shift[1], defocus_um],
                azimuth_rad: azimuth,
                descent_rad: 0.5,
                opening_radius_um: 1.0,
                half_angle_rad: 0.09,
                contrast: 0.12,
            };
            let light = Light { vignetting: 0.08, slope: [0.02, -0.01] };
            let scene = Scene { light, pipettes: vec![pipette], ..Scene::default() };
            let frame = scene.render(&view, &Exposure { level: 0.5, shot_noise: 0.01, read_noise: 0.001, seed });
            Picture::grey16(frame.width, frame.height, frame.pixels).unwrap()
        };
        [picture(jog_um, 2 * seed), picture([0.0, 0.0], 2 * seed + 1)]
    }

    /// The frame's direction of a direction in ref: this view has y upwards in ref, downwards in the picture.
    fn in_picture(view_x: f64, view_y: f64) -> Vector2<f64> {
        let view = Viewpoint::level([0.0, 0.0], 0.0, PIXEL_UM, 640, 480);
        let origin = view.picture_px([0.0, 0.0]).unwrap();
        let there = view.picture_px([view_x, view_y]).unwrap();
        Vector2::new(there[0] - origin[0], there[1] - origin[1])
    }

    /// The end of what changed lies beyond a tip by no more than its blur, and is smeared by the smoothing and the jog's rounding.
    #[test]
    fn a_jogged_pipettes_end_is_its_tip_to_within_its_blur() {
        for (seed, azimuth, defocus) in
            [(1, 0.2, 0.0), (2, 2.8, 10.0), (3, -1.3, -30.0), (4, 0.9, 4.0), (5, 4.0, -15.0)]
        {
            let within = Optics::WATER_40X.body_blur_um(defocus) / PIXEL_UM + HALF as f64 + 3.0;
            let across: [f64; 2] = [-9.0 * f64::sin(azimuth), 9.0 * f64::cos(azimuth)];
            let [a, b] = frames([300.0, 250.0], azimuth, defocus, across, seed);
            let towards = in_picture(azimuth.cos(), azimuth.sin());
            let found = jogged(&a, &b, in_picture(across[0], across[1]), towards);
            let Some(Jogged::Tip(at)) = found else { panic!("seed {seed}: {found:?}") };
            let off = (at.x_px - 300.0).hypot(at.y_px - 250.0);
            println!("defocus {defocus}: {off:.1} px off, {within:.1} allowed");
            assert!(off < within, "seed {seed}: {at:?} is {off:.1} px off, {within:.1} allowed");
        }
    }

    #[test]
    fn a_tip_beyond_the_border_is_told_from_one_in_the_picture_and_from_none() {
        let (azimuth, across) = (0.0, [0.0, 9.0]);
        let towards = in_picture(1.0, 0.0);
        let [a, b] = frames([700.0, 250.0], azimuth, 3.0, across, 4);
        assert!(matches!(jogged(&a, &b, in_picture(0.0, 9.0), towards), Some(Jogged::Beyond(_))));
        let [a, b] = frames([-300.0, 250.0], azimuth, 3.0, across, 5);
        assert_eq!(jogged(&a, &b, in_picture(0.0, 9.0), towards), None);
    }
}
