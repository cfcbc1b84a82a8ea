//! How well the renderer shows what a real focal stack does: a pipette is fitted to all of its planes at once.

use anyhow::{Context, bail};
use image::{GrayImage, Luma};
use parfocal_simulator::scene::{Exposure, Kernel, Optics, Pipette, Scene, Viewpoint};
use std::path::Path;

/// The stack's note: grey value of the background, µm per pixel and per plane, the plane in focus, the pipette's descent.
const BACKGROUND: f64 = 30_000.0;
const PIXEL_UM: f64 = 0.3236;
const PLANE_UM: f64 = 1.57;
const FOCUSED: f64 = 25.0;
const DESCENT_DEG: f64 = 31.3;

/// Planes that are fitted and drawn.
const PLANES: [u32; 7] = [19, 21, 23, 25, 27, 29, 31];

/// Rows from the top: the tip and the first of the shank.
const ROWS: usize = 64;

/// The row where the operator saw the tip.
const TIP_ROW: f64 = 15.12;

/// What is fitted: the tip's column in plane 25, bent light as a factor to the objective's, columns that the picture walks per plane, height of the tip above plane
/// 25 (µm), opening's radius (µm), half of the cone's angle (rad).
type Numbers = [f64; 6];
const START: Numbers = [26.9, 1.0, -0.26, 0.0, 1.5, 0.15];
const STEPS: Numbers = [1.0, 0.3, 0.1, 1.5, 0.3, 0.04];

/// A plane's light, less the background, row after row.
struct Plane {
    number: u32,
    width: usize,
    light: Vec<f64>,
}

/// Fits, prints the share of each plane's light that the rendered one explains, and draws the real planes above the rendered.
pub fn compare(folder: &Path, picture: &Path) -> anyhow::Result<()> {
    let planes: Vec<Plane> = PLANES.iter().map(|plane| read(folder, *plane)).collect::<anyhow::Result<_>>()?;
    let mut best: Option<(f64, Kernel, Numbers)> = None;
    for kernel in [Kernel::Disc, Kernel::Gaussian] {
        let (left, numbers) = descend(&planes, kernel);
        println!(
            "{kernel:?}: explains {:.1} % of {} planes' light, with {numbers:.2?}",
            100.0 * (1.0 - left),
            planes.len()
        );
        if best.is_none_or(|(least, ..)| left < least) {
            best = Some((left, kernel, numbers));
        }
    }
    let Some((_, kernel, numbers)) = best else { bail!("no kernel") };
    let drawn: Vec<Vec<f64>> = planes.iter().map(|plane| scaled(plane, &render(plane, kernel, &numbers)).1).collect();
    for (plane, drawn) in planes.iter().zip(&drawn) {
        let share = 1.0 - left(plane, drawn) / squares(&plane.light);
        let away = PLANE_UM * (f64::from(plane.number) - FOCUSED);
        println!("plane {} ({away:+.1} µm): {:.0} % explained", plane.number, 100.0 * share);
    }
    save(picture, &planes, &drawn)
}

fn read(folder: &Path, number: u32) -> anyhow::Result<Plane> {
    let file = folder.join(format!("z{number:03}.png"));
    let image = image::open(&file).with_context(|| file.display().to_string())?.into_luma16();
    let (width, height) = (image.width() as usize, image.height() as usize);
    if height < ROWS {
        bail!("{}: has {height} rows, {ROWS} are looked at", file.display());
    }
    let light = image.as_raw()[..ROWS * width].iter().map(|v| f64::from(*v) - BACKGROUND).collect();
    Ok(Plane { number, width, light })
}

/// The relative light of a plane as rendered.
fn render(plane: &Plane, kernel: Kernel, [x, bent, walk, height_um, opening_um, half_angle]: &Numbers) -> Vec<f64> {
    let off = f64::from(plane.number) - FOCUSED;
    // Later planes lie deeper up the shank: the focal plane rises.
    let view = Viewpoint {
        optics: Optics { kernel, edge_gain: bent * Optics::WATER_40X.edge_gain, ..Optics::WATER_40X },
        ..Viewpoint::level([0.0, 0.0], PLANE_UM * off, PIXEL_UM, plane.width, ROWS)
    };
    let [tip_x, tip_y] = view.ref_um(x + walk * off, TIP_ROW);
    let pipette = Pipette {
        tip_um: [tip_x, tip_y, *height_um],
        azimuth_rad: std::f64::consts::FRAC_PI_2,
        descent_rad: DESCENT_DEG.to_radians(),
        opening_radius_um: *opening_um,
        half_angle_rad: *half_angle,
        contrast: 0.1,
    };
    let frame = Scene { pipettes: vec![pipette], ..Scene::default() }.render(&view, &Exposure::NOISELESS);
    frame.pixels.iter().map(|v| f64::from(*v) / 32_767.5 - 1.0).collect()
}

/// The rendered light at the strength, and over the level, that suit the plane best; and the squares that it leaves.
fn scaled(plane: &Plane, drawn: &[f64]) -> (f64, Vec<f64>) {
    let n = drawn.len() as f64;
    let (mean, seen) = (drawn.iter().sum::<f64>() / n, plane.light.iter().sum::<f64>() / n);
    let both: f64 = drawn.iter().zip(&plane.light).map(|(d, v)| (d - mean) * (v - seen)).sum();
    let own: f64 = drawn.iter().map(|d| (d - mean).powi(2)).sum();
    let strength = both / own.max(f64::MIN_POSITIVE);
    let scaled: Vec<f64> = drawn.iter().map(|d| seen + strength * (d - mean)).collect();
    (left(plane, &scaled), scaled)
}

fn left(plane: &Plane, drawn: &[f64]) -> f64 {
    drawn.iter().zip(&plane.light).map(|(d, v)| (d - v).powi(2)).sum()
}

fn squares(light: &[f64]) -> f64 {
    let mean = light.iter().sum::<f64>() / light.len() as f64;
    light.iter().map(|v| (v - mean).powi(2)).sum()
}

/// Looks about each number in turn, in ever smaller steps; the share of the planes' squares that is left.
fn descend(planes: &[Plane], kernel: Kernel) -> (f64, Numbers) {
    let total: f64 = planes.iter().map(|p| squares(&p.light)).sum();
    let cost = |numbers: &Numbers| planes.iter().map(|p| scaled(p, &render(p, kernel, numbers)).0).sum::<f64>() / total;
    let (mut at, mut steps) = (START, STEPS);
    let mut least = cost(&at);
    for _ in 0..40 {
        for k in 0..at.len() {
            let mut moved = false;
            for sign in [1.0, -1.0] {
                let mut next = at;
                next[k] += sign * steps[k];
                if next[4] > 0.1 && next[5] > 0.01 && cost(&next) < least {
                    (least, at, moved) = (cost(&next), next, true);
                    break;
                }
            }
            steps[k] *= if moved { 1.2 } else { 0.6 };
        }
    }
    (least, at)
}

/// Real planes above, rendered ones below, three times as large, in one scale of greys.
fn save(file: &Path, planes: &[Plane], drawn: &[Vec<f64>]) -> anyhow::Result<()> {
    const LARGER: usize = 3;
    const GAP: usize = 2;
    let width = planes.iter().map(|p| p.width + GAP).sum::<usize>() - GAP;
    let most = planes.iter().flat_map(|p| &p.light).fold(1.0_f64, |most, v| most.max(v.abs()));
    let grey = |v: f64| Luma([(127.5 + 127.5 * v / most).clamp(0.0, 255.0) as u8]);
    let mut image = GrayImage::from_pixel((LARGER * width) as u32, (LARGER * (2 * ROWS + GAP)) as u32, Luma([255]));
    let mut from = 0;
    for (plane, drawn) in planes.iter().zip(drawn) {
        for (row, light) in [(0, &plane.light), (ROWS + GAP, drawn)] {
            for (i, value) in light.iter().enumerate() {
                let (x, y) = (from + i % plane.width, row + i / plane.width);
                for part in 0..LARGER * LARGER {
                    let (dx, dy) = (part % LARGER, part / LARGER);
                    image.put_pixel((LARGER * x + dx) as u32, (LARGER * y + dy) as u32, grey(*value));
                }
            }
        }
        from += plane.width + GAP;
    }
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    image.save(file).with_context(|| file.display().to_string())
}
