//! Where to focus when nobody says: the tile with the sharpest texture.

use super::quality::is_top;
use super::simd::{self, Pixel, Plane};
use super::with_plane;
use crate::picture::{Roi, View};

/// Standard errors by which a tile's texture must rise above what noise alone would show.
const SIGNIFICANT: f64 = 5.0;
/// Gradient energy, grey levels squared, that rounding to whole grey levels may feign in a smooth picture.
const ROUNDING: f64 = 0.25;
/// Share of a tile's pixels at the top of the scale from which on its edges are cut off rather than sharp.
const SATURATED_SHARE: f64 = 0.02;

/// The square tile of `tile_size` px a side (less in a smaller picture) with the sharpest texture; neighbouring tiles
/// overlap by half.
///
/// Texture is the covariance of gradients taken from *neighbouring* rows, and columns: structure is common to both, the
/// noise of pixels is not. So a noisy bright area does not outdo a faint sharp edge, whatever the noise is and however it grows with
/// brightness; and an even slope of the illumination counts nothing.
///
/// `None` when no tile rises above noise and rounding, or where those that do are saturated: there is nothing to
/// focus on, or the light has to be set first.
pub fn sharpest_tile(view: View<'_>, tile_size: usize) -> Option<Roi> {
    let (width, height) = (tile_size.min(view.width()), tile_size.min(view.height()));
    if width < 4 || height < 4 {
        return None;
    }
    let top = with_plane!(view, |plane| top_of(&plane));
    let mut best: Option<(f64, Roi)> = None;
    for y in starts(view.height(), height) {
        for x in starts(view.width(), width) {
            let roi = Roi { x, y, width, height };
            let tile = view.crop(roi).ok()?;
            let Some(texture) = with_plane!(tile, |plane| texture(&plane, top)) else { continue };
            if best.is_none_or(|(most, _)| texture > most) {
                best = Some((texture, roi));
            }
        }
    }
    best.map(|(_, roi)| roi)
}

/// Where tiles begin along one side: every half tile, and the last one at the edge.
fn starts(whole: usize, tile: usize) -> impl Iterator<Item = usize> {
    let last = whole - tile;
    (0..last).step_by(tile / 2).chain([last])
}

/// The top of the camera's scale, if the picture reaches it.
fn top_of<P: Pixel>(plane: &Plane<'_, P>) -> Option<u32> {
    Some(simd::extremes(plane).1).filter(|&high| is_top::<P>(high))
}

/// Sums over pairs (a, b) of gradients.
#[derive(Default)]
struct Pairs {
    n: f64,
    a: f64,
    b: f64,
    ab: f64,
    squares: f64,
}

impl Pairs {
    fn add(&mut self, a: i32, b: i32) {
        let (a, b) = (f64::from(a), f64::from(b));
        self.n += 1.0;
        self.a += a;
        self.b += b;
        self.ab += a * b;
        self.squares += 0.5 * (a * a + b * b);
    }

    /// Covariance, and the mean of both variances.
    fn covariance(&self) -> (f64, f64) {
        let slope = self.a / self.n * (self.b / self.n);
        (self.ab / self.n - slope, self.squares / self.n - slope)
    }
}

/// Gradient energy of a tile's structure, if it is significant and the tile is not saturated.
fn texture<P: Pixel>(tile: &Plane<'_, P>, top: Option<u32>) -> Option<f64> {
    if let Some(top) = top {
        let cut: usize = tile.rows().map(|row| row.iter().filter(|&&p| Into::<u32>::into(p) == top).count()).sum();
        if cut as f64 > SATURATED_SHARE * tile.area() as f64 {
            return None;
        }
    }
    let (mut across, mut down) = (Pairs::default(), Pairs::default());
    for y in 2..tile.height() {
        let [u, c, d] = tile.band(y - 2);
        for ((u, c), d) in u.array_windows().zip(c.array_windows()).zip(d.array_windows()) {
            let [u, c, d]: [[i32; 3]; 3] = [u.map(Into::into), c.map(Into::into), d.map(Into::into)];
            across.add(u[2] - u[0], c[2] - c[0]);
            down.add(d[0] - u[0], d[1] - u[1]);
        }
    }
    let ((cx, vx), (cy, vy)) = (across.covariance(), down.covariance());
    let texture = cx + cy;
    (texture > ROUNDING && texture > SIGNIFICANT * (vx + vy) / across.n.sqrt()).then_some(texture)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Picture;
    use rand::{RngExt, SeedableRng};

    /// 16-bit picture of `f(x, y)` with noise of ±`noise(x)` on each pixel.
    fn noisy(seed: u64, noise: impl Fn(usize) -> f64, f: impl Fn(usize, usize) -> f64) -> Picture {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        let value = |i: usize| {
            let (x, y) = (i % 192, i / 192);
            (f(x, y) + noise(x) * (2.0 * random.random::<f64>() - 1.0)).round() as u16
        };
        Picture::grey16(192, 128, (0..192 * 128).map(value).collect()).unwrap()
    }

    /// Stripes of 6 px with soft edges, only in 32 x 32 px around (48, 80).
    fn patch(x: usize, y: usize) -> f64 {
        let inside = x.abs_diff(48) < 16 && y.abs_diff(80) < 16;
        if inside { 40.0 * (x as f64 * std::f64::consts::TAU / 6.0).sin() } else { 0.0 }
    }

    #[test]
    fn faint_texture_beats_strong_noise_beside_it() {
        for seed in 0..20 {
            let noise = |x: usize| if x > 96 { 150.0 } else { 30.0 };
            let picture = noisy(seed, noise, |x, y| 3_000.0 + patch(x, y));
            let roi = sharpest_tile(picture.view(), 32).unwrap();
            assert!(roi.x.abs_diff(32) <= 16 && roi.y.abs_diff(64) <= 16, "seed {seed}: {roi}");
        }
    }

    #[test]
    fn nothing_is_found_in_blank_noisy_or_evenly_sloping_pictures() {
        for seed in 0..20 {
            assert_eq!(sharpest_tile(noisy(seed, |_| 0.0, |_, _| 500.0).view(), 32), None);
            assert_eq!(sharpest_tile(noisy(seed, |_| 60.0, |_, _| 500.0).view(), 32), None, "seed {seed}");
            let slope = |x: usize, y: usize| 500.0 + 2.0 * x as f64 + y as f64;
            assert_eq!(sharpest_tile(noisy(seed, |_| 20.0, slope).view(), 32), None, "seed {seed}");
        }
        let white = Picture::grey8(64, 64, vec![255; 4096]).unwrap();
        assert_eq!(sharpest_tile(white.view(), 16), None);
    }

    #[test]
    fn saturated_tiles_are_passed_over() {
        let glare = |x: usize, y: usize| if x > 120 && y % 8 < 3 { 4_095.0 } else { 1_000.0 + patch(x, y) };
        let roi = sharpest_tile(noisy(1, |_| 0.0, glare).view(), 32).unwrap();
        assert!(roi.x < 96, "{roi}");
        let all_cut = |x: usize, y: usize| if (x / 8 + y / 8).is_multiple_of(2) { 4_095.0 } else { 0.0 };
        assert_eq!(sharpest_tile(noisy(1, |_| 0.0, all_cut).view(), 32), None);
    }

    #[test]
    fn tiles_larger_than_the_picture_are_the_picture_and_tiny_pictures_have_none() {
        let picture = noisy(3, |_| 0.0, |x, y| 500.0 + patch(x, y));
        let whole = Roi { x: 0, y: 0, width: 192, height: 128 };
        assert_eq!(sharpest_tile(picture.view(), 1_000), Some(whole));
        assert_eq!(sharpest_tile(picture.view(), 3), None);
        assert_eq!(sharpest_tile(Picture::grey8(1, 1, vec![9]).unwrap().view(), 64), None);
    }
}
