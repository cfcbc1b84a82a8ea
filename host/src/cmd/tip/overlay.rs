//! A picture with its tip marked.

use image::{Rgb, RgbImage};
use parfocal::picture::Picture;
use parfocal::tip::Tip;

const MARK: Rgb<u8> = Rgb([255, 64, 32]);

/// The picture, stretched to its own contrast, with a cross at the tip and a line along the shank.
pub fn draw(picture: &Picture, tip: Option<Tip>) -> RgbImage {
    let view = picture.view();
    let (width, height) = (view.width(), view.height());
    let mut sorted: Vec<u16> = (0..height).flat_map(|y| (0..width).filter_map(move |x| view.get(x, y))).collect();
    sorted.sort_unstable();
    // A thousandth at either end may be dirt.
    let (low, high) = (sorted[sorted.len() / 1000], sorted[sorted.len() - 1 - sorted.len() / 1000]);
    let span = f64::from((high - low).max(1));
    let mut image = RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let value = f64::from(view.get(x as usize, y as usize).unwrap_or(low)) - f64::from(low);
        let grey = (255.0 * value / span).clamp(0.0, 255.0) as u8;
        Rgb([grey, grey, grey])
    });
    if let Some(tip) = tip {
        let (sin, cos) = tip.angle_deg.to_radians().sin_cos();
        let mut mark = |x: f64, y: f64| {
            let (x, y) = (x.round(), y.round());
            if x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64 {
                image.put_pixel(x as u32, y as u32, MARK);
            }
        };
        for i in -8..=8 {
            let across = f64::from(i);
            mark(tip.x_px - across * sin, tip.y_px + across * cos);
        }
        for i in 4..60 {
            let back = f64::from(i);
            mark(tip.x_px - back * cos, tip.y_px - back * sin);
        }
    }
    image
}
