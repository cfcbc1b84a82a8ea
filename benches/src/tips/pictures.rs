//! Pictures of scenes for people to look at: green where the tip is, red where it was seen.

use super::figures::Row;
use anyhow::Context;
use image::{Rgb, RgbImage};
use parfocal::picture::Picture;
use std::path::Path;

/// Draws a scene; the file's name says what came of it.
pub fn save(folder: &Path, row: &Row, picture: &Picture) -> anyhow::Result<()> {
    let view = picture.view();
    let (width, height) = (view.width(), view.height());
    let value = |x: usize, y: usize| f64::from(view.get(x, y).unwrap_or_default());
    let mut sorted: Vec<f64> =
        (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| value(x, y)).collect();
    sorted.sort_by(f64::total_cmp);
    let (low, high) = (sorted[sorted.len() / 500], sorted[sorted.len() - 1 - sorted.len() / 500]);
    let mut image = RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let grey = (255.0 * (value(x as usize, y as usize) - low) / (high - low).max(1.0)).clamp(0.0, 255.0) as u8;
        Rgb([grey; 3])
    });
    if let (Some([x, y]), Some(angle)) = (row.truth_px, row.truth_deg) {
        arrow(&mut image, x, y, angle, Rgb([0, 255, 0]));
    }
    if let Some(tip) = row.tip {
        arrow(&mut image, tip.x_px, tip.y_px, tip.angle_deg, Rgb([255, 0, 0]));
    }
    let outcome = match (row.error_px, row.tip) {
        (Some(error), _) if !row.show.ends_with("shank") => format!("{error:05.1}px"),
        (_, Some(tip)) => format!("false-{:.2}", tip.confidence),
        _ => "missed".into(),
    };
    let file =
        folder.join(format!("{}-{outcome}-{:+.1}um-{}.png", row.show.replace(' ', "-"), row.defocus_um, row.seed));
    image.save(&file).with_context(|| file.display().to_string())
}

/// A cross bar at the tip and a dotted line aside of the shank.
fn arrow(image: &mut RgbImage, x: f64, y: f64, angle_deg: f64, colour: Rgb<u8>) {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let mut mark = |x: f64, y: f64| {
        let (x, y) = (x.round(), y.round());
        if x >= 0.0 && y >= 0.0 && x < f64::from(image.width()) && y < f64::from(image.height()) {
            image.put_pixel(x as u32, y as u32, colour);
        }
    };
    for i in -12..=12 {
        let across = f64::from(i);
        mark(x - across * sin, y + across * cos);
    }
    for i in 4..20 {
        let back = 3.0 * f64::from(i);
        mark(x - back * cos, y - back * sin);
    }
}
