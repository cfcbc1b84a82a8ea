//! Where a marker's edges lie in a picture, to a few hundredths of a pixel.
//!
//! Every border between a black and a white square of a marker, the inner ones too, is cut into pieces about one square long. Across a
//! piece the picture is modelled as a step blurred by a Gaussian, `B + (W − B)·Φ((d − d₀)/σ)`, raised to 1/γ for pictures that
//! are gamma-encoded, and d₀ is fitted to the pixels themselves, without resampling. Blur is shared by a marker's pieces, so
//! a piece has to determine only its two levels, known beforehand from the squares around it, and its place.

use super::blur::{gauss, step};
use super::levels::Levels;
use super::marker::{BORDER_CELLS, CELLS, Cells};
use crate::picture::{Data, Picture};
use nalgebra::{Matrix3, Vector2, Vector3};

/// A grey picture for measuring: values 0 to 255, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Grey {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height` values.
    pub values: Vec<f32>,
}

impl From<&Picture> for Grey {
    /// 16-bit pictures are scaled by the least number of bits that holds their brightest value: 10, 12, 14 or 16.
    fn from(picture: &Picture) -> Self {
        let values = match &picture.data {
            Data::Grey8(data) => data.iter().map(|v| f32::from(*v)).collect(),
            Data::Grey16(data) => {
                let most = data.iter().copied().max().unwrap_or(0);
                let bits = [10u32, 12, 14].into_iter().find(|bits| u32::from(most) < 1 << bits).unwrap_or(16);
                let scale = 255.0 / ((1u32 << bits) - 1) as f32;
                data.iter().map(|v| f32::from(*v) * scale).collect()
            }
        };
        Self { width: picture.width, height: picture.height, values }
    }
}

impl Grey {
    /// The value at a pixel position, interpolated; `None` outside.
    pub fn at(&self, p: Vector2<f64>) -> Option<f64> {
        let (x, y) = (p.x.floor(), p.y.floor());
        if !(x >= 0.0 && y >= 0.0 && x + 1.0 < self.width as f64 && y + 1.0 < self.height as f64) {
            return None;
        }
        let (fx, fy, i) = (p.x - x, p.y - y, y as usize * self.width + x as usize);
        let v = |k: usize| f64::from(self.values[i + k]);
        let (top, bottom) = (v(0) * (1.0 - fx) + v(1) * fx, v(self.width) * (1.0 - fx) + v(self.width + 1) * fx);
        Some(top * (1.0 - fy) + bottom * fy)
    }
}

/// How a picture's values relate to light, and how sharp it is around one marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// The values are light^(1/gamma).
    pub gamma: f64,
    /// Standard deviation of the blur, px.
    pub blur_px: f64,
}

/// A straight border between black and white squares, in the marker's plane, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Border {
    start: Vector2<f64>,
    end: Vector2<f64>,
    /// Unit vector from the black side to the white one.
    to_white: Vector2<f64>,
}

/// All borders of a marker, as long as they run straight with the same colours on either side.
pub fn borders(cells: &Cells, size_mm: f64) -> Vec<Border> {
    let cell = size_mm / BORDER_CELLS as f64;
    let place = |k: usize| (k as f64 - CELLS as f64 / 2.0) * cell;
    let mut all = Vec::new();
    for upright in [false, true] {
        let white = |line: usize, k: usize| if upright { cells[k][line] } else { cells[line][k] };
        let point = |line: usize, k: usize| {
            if upright { Vector2::new(place(line), place(k)) } else { Vector2::new(place(k), place(line)) }
        };
        for line in 1..CELLS {
            let kind = |k: usize| (k < CELLS).then(|| (white(line - 1, k), white(line, k))).filter(|(a, b)| a != b);
            let mut from = 0;
            for k in 0..CELLS {
                if kind(k) != kind(k + 1) {
                    if let Some((_, ahead)) = kind(k) {
                        let across = if upright { Vector2::x() } else { Vector2::y() };
                        let to_white = if ahead { across } else { -across };
                        all.push(Border { start: point(line, from), end: point(line, k + 1), to_white });
                    }
                    from = k + 1;
                }
            }
        }
    }
    all
}

/// A measured piece of an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// The piece's middle in the marker's plane, mm.
    pub middle: Vector2<f64>,
    /// Unit vector in the picture, from black to white.
    pub normal: Vector2<f64>,
    /// How far along `normal` the edge lies from where it was expected, px.
    pub offset_px: f64,
    /// Variance of `offset_px` for a noise of 1 level.
    pub variance: f64,
    /// Sum of squared residuals of the fit, levels², and the degrees of freedom left.
    pub misfit: (f64, f64),
    /// What a change of blur by 1 px would take off the residuals: Σ r·s and Σ s².
    pub sharper: (f64, f64),
}

/// Measures a marker's borders where `project` says they are. Pieces outside the picture, too small, or not darker on their
/// black side are left out; the second number is how many pieces there were to measure.
pub fn measure(
    picture: &Grey,
    borders: &[Border],
    size_mm: f64,
    tone: Tone,
    levels: &Levels,
    project: &dyn Fn(Vector2<f64>) -> Option<Vector2<f64>>,
) -> (Vec<Edge>, usize) {
    let cell = size_mm / BORDER_CELLS as f64;
    let mut edges = Vec::new();
    let mut tried = 0;
    for border in borders {
        let Some((start, end)) = project(border.start).zip(project(border.end)) else { continue };
        let length = (border.end - border.start).norm();
        let along = (border.end - border.start) / length;
        // Where a border turns, the blur of the next one reaches in.
        let scale = (end - start).norm() / length;
        let usable = length - 2.0 * 2.0 * tone.blur_px / scale;
        let pieces = (usable / cell).round().max(1.0);
        if usable * scale < 2.0 {
            continue;
        }
        for k in 0..pieces as usize {
            let middle = border.start + along * ((length - usable) / 2.0 + usable * (k as f64 + 0.5) / pieces);
            let half = along * (usable / pieces / 2.0);
            if let Some(piece) = Piece::new(middle, half, border.to_white, cell, tone, project) {
                tried += 1;
                edges.extend(piece.fit(picture, tone, levels));
            }
        }
    }
    (edges, tried)
}

/// A piece of a border as it should appear in the picture.
struct Piece {
    middle: Vector2<f64>,
    at: Vector2<f64>,
    along: Vector2<f64>,
    normal: Vector2<f64>,
    half_length: f64,
    half_width: f64,
}

impl Piece {
    fn new(
        middle: Vector2<f64>,
        half: Vector2<f64>,
        to_white: Vector2<f64>,
        cell: f64,
        tone: Tone,
        project: &dyn Fn(Vector2<f64>) -> Option<Vector2<f64>>,
    ) -> Option<Self> {
        let (a, b, at) = (project(middle - half)?, project(middle + half)?, project(middle)?);
        let (black, white) = (project(middle - to_white * cell)?, project(middle + to_white * cell)?);
        let along = (b - a).try_normalize(1e-9)?;
        let mut normal = Vector2::new(-along.y, along.x);
        if normal.dot(&(white - at)) < 0.0 {
            normal = -normal;
        }
        // The next border may be one square away; its blur must not reach in.
        let room = normal.dot(&(white - at)).min(normal.dot(&(at - black))) - 1.2 * tone.blur_px;
        let half_width = room.min(3.5 * tone.blur_px + 1.5);
        (half_width >= 1.4).then_some(Self { middle, at, along, normal, half_length: (b - a).norm() / 2.0, half_width })
    }

    /// Pixels of the piece: signed distance from the expected edge, value 0 to 255.
    fn pixels(&self, picture: &Grey) -> Option<Vec<(f64, f64)>> {
        // Plain numbers: this is where most of the time goes.
        let ([x0, y0], [ax, ay], [nx, ny]) = (self.at.into(), self.along.into(), self.normal.into());
        let reach = |along: f64, normal: f64| along.abs() * self.half_length + normal.abs() * self.half_width;
        let (rx, ry): (f64, f64) = (reach(ax, nx), reach(ay, ny));
        let (left, top, right, bottom): (f64, f64, f64, f64) = (x0 - rx, y0 - ry, x0 + rx, y0 + ry);
        if left < 0.0 || top < 0.0 || right > picture.width as f64 - 1.0 || bottom > picture.height as f64 - 1.0 {
            return None;
        }
        let mut pixels = Vec::new();
        for y in top.ceil() as usize..=bottom as usize {
            for x in left.ceil() as usize..=right as usize {
                let (dx, dy) = (x as f64 - x0, y as f64 - y0);
                let d: f64 = dx * nx + dy * ny;
                if (dx * ax + dy * ay).abs() <= self.half_length && d.abs() <= self.half_width {
                    pixels.push((d, f64::from(picture.values[y * picture.width + x])));
                }
            }
        }
        (pixels.len() >= 8).then_some(pixels)
    }

    /// Levels and place of the edge by Gauss and Newton; `None` when it runs away or the black side is not darker.
    fn fit(&self, picture: &Grey, tone: Tone, levels: &Levels) -> Option<Edge> {
        let pixels = self.pixels(picture)?;
        let (black, white) = levels.at(self.middle);
        let prior = 255.0 * 255.0 / (0.1 * (white - black) * 255.0).powi(2);
        // Black level, white level, place.
        let mut guess = [black, white, 0.0];
        let mut cost = (0.0, (0.0, 0.0));
        let mut normal = Matrix3::zeros();
        for _ in 0..6 {
            let mut g = [(black - guess[0]) * prior, (white - guess[1]) * prior, 0.0];
            let mut n = [prior, 0.0, 0.0, prior, 0.0, 1e-9 * 255.0 * 255.0];
            cost = (0.0, (0.0, 0.0));
            let contrast = guess[1] - guess[0];
            for &(d, value) in &pixels {
                let u = (d - guess[2]) / tone.blur_px;
                let (phi, bell) = (step(u), gauss(u) / tone.blur_px);
                let (level, slope) = encode(guess[0] + contrast * phi, tone.gamma);
                let (a, b, c) = ((1.0 - phi) * slope, phi * slope, -contrast * bell * slope);
                let miss = value - level;
                g = [g[0] + a * miss, g[1] + b * miss, g[2] + c * miss];
                n = [n[0] + a * a, n[1] + a * b, n[2] + a * c, n[3] + b * b, n[4] + b * c, n[5] + c * c];
                cost.0 += miss * miss;
                cost.1.0 += miss * c * u;
                cost.1.1 += c * u * c * u;
            }
            normal = Matrix3::new(n[0], n[1], n[2], n[1], n[3], n[4], n[2], n[4], n[5]);
            let delta = normal.cholesky()?.solve(&Vector3::from(g));
            guess = [guess[0] + delta.x, guess[1] + delta.y, guess[2] + delta.z.clamp(-1.0, 1.0)];
            if !(guess[2].abs() < self.half_width && guess[1] - guess[0] > 0.3 * (white - black)) {
                return None;
            }
            guess[0] = guess[0].max(1e-4);
            if delta.z.abs() < 1e-4 {
                break;
            }
        }
        let inverse = normal.try_inverse()?;
        Some(Edge {
            middle: self.middle,
            normal: self.normal,
            offset_px: guess[2],
            variance: inverse[(2, 2)],
            misfit: (cost.0, pixels.len() as f64 - 1.5),
            sharper: cost.1,
        })
    }
}

/// The picture's value, 0 to 255, of a light between 0 and 1, and the value's change with the light.
fn encode(light: f64, gamma: f64) -> (f64, f64) {
    if gamma == 1.0 {
        return (255.0 * light, 255.0);
    }
    let light = light.max(1e-4);
    let value = 255.0 * light.powf(1.0 / gamma);
    (value, value / light / gamma)
}

#[cfg(test)]
mod tests {
    use super::super::MarkerId;
    use super::super::marker::cells;
    use super::*;

    #[test]
    fn borders_part_black_from_white_and_hold_the_outline() {
        let cells = cells(MarkerId(3)).unwrap();
        let borders = borders(&cells, 8.0);
        let white = |p: Vector2<f64>| cells[(p.y + 5.0) as usize][(p.x + 5.0) as usize];
        for b in &borders {
            let middle = (b.start + b.end) / 2.0 - (b.end - b.start).normalize() * 0.25;
            assert!(white(middle + b.to_white * 0.5) && !white(middle - b.to_white * 0.5), "{b:?}");
        }
        assert_eq!(borders.iter().filter(|b| (b.end - b.start).norm() == 8.0).count(), 4);
        let units: f64 = borders.iter().map(|b| (b.end - b.start).norm()).sum();
        let mut pairs = 0;
        #[allow(clippy::needless_range_loop, reason = "rows and columns are taken alike")]
        for i in 0..CELLS {
            for j in 1..CELLS {
                pairs += usize::from(cells[i][j] != cells[i][j - 1]) + usize::from(cells[j][i] != cells[j - 1][i]);
            }
        }
        assert_eq!(units, pairs as f64);
    }
}
