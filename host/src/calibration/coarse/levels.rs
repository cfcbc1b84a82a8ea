//! How bright black and white are across a marker: uneven light is a plane over something this small.

use super::edges::{Grey, Tone};
use super::marker::{BORDER_CELLS, CELLS, Cells};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Light of black and of white squares, 0 to 1, each as a plane over the marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Levels {
    black: Vector3<f64>,
    white: Vector3<f64>,
    scale_mm: f64,
    /// Correlation of the squares' light with the marker's pattern, -1 to 1.
    pub likeness: f64,
}

impl Levels {
    /// Light of black and white at a point of the marker, mm.
    pub fn at(&self, p: Vector2<f64>) -> (f64, f64) {
        let at = Vector3::new(1.0, p.x / self.scale_mm, p.y / self.scale_mm);
        let black = self.black.dot(&at).max(0.0);
        (black, self.white.dot(&at).max(black + 0.01))
    }

    /// Reads the squares' middles. `None` when too few are in the picture or white is not brighter than black.
    pub fn read(
        picture: &Grey,
        cells: &Cells,
        size_mm: f64,
        tone: Tone,
        project: &dyn Fn(Vector2<f64>) -> Option<Vector2<f64>>,
    ) -> Option<Self> {
        let cell = size_mm / BORDER_CELLS as f64;
        let mut samples: [Vec<(Vector3<f64>, f64)>; 2] = [Vec::new(), Vec::new()];
        for (row, line) in cells.iter().enumerate() {
            for (column, &white) in line.iter().enumerate() {
                let middle = Vector2::new(column as f64 - 4.5, row as f64 - 4.5) * cell;
                let spots = [(0.0, 0.0), (0.2, 0.2), (-0.2, 0.2), (0.2, -0.2), (-0.2, -0.2)];
                let sum: Option<f64> =
                    spots.iter().map(|s| picture.at(project(middle + Vector2::new(s.0, s.1) * cell)?)).sum();
                if let Some(sum) = sum {
                    let light = (sum / 5.0 / 255.0).max(0.0).powf(tone.gamma);
                    let at = Vector3::new(1.0, middle.x / size_mm, middle.y / size_mm);
                    samples[usize::from(white)].push((at, light));
                }
            }
        }
        if samples.iter().map(Vec::len).sum::<usize>() < CELLS * CELLS / 2 {
            return None;
        }
        let (black, white) = (plane(&samples[0])?, plane(&samples[1])?);
        let levels = Self { black, white, scale_mm: size_mm, likeness: likeness(&samples) };
        (white[0] - black[0] > 0.03).then_some(levels)
    }
}

/// A plane through samples, those far off (hidden squares) left out.
fn plane(samples: &[(Vector3<f64>, f64)]) -> Option<Vector3<f64>> {
    let mut kept: Vec<_> = samples.to_vec();
    let mut values: Vec<f64> = kept.iter().map(|s| s.1).collect();
    values.sort_by(f64::total_cmp);
    let mut fit = Vector3::new(*values.get(values.len() / 2)?, 0.0, 0.0);
    for _ in 0..4 {
        let mut far: Vec<f64> = samples.iter().map(|(at, v)| (v - fit.dot(at)).abs()).collect();
        far.sort_by(f64::total_cmp);
        let limit = (3.0 * 1.4826 * far[far.len() / 2]).max(0.02);
        kept.clear();
        kept.extend(samples.iter().filter(|(at, v)| (v - fit.dot(at)).abs() <= limit));
        if kept.len() < 6 {
            return None;
        }
        let normal: Matrix3<f64> = kept.iter().map(|(at, _)| at * at.transpose()).sum::<Matrix3<f64>>()
            + Matrix3::from_diagonal(&Vector3::new(0.0, 0.05, 0.05));
        fit = normal.cholesky()?.solve(&kept.iter().map(|(at, v)| at * *v).sum());
    }
    Some(fit)
}

fn likeness(samples: &[Vec<(Vector3<f64>, f64)>; 2]) -> f64 {
    let count = samples.iter().map(Vec::len).sum::<usize>() as f64;
    let mean = samples.iter().flatten().map(|s| s.1).sum::<f64>() / count;
    let share = samples[1].len() as f64 / count;
    let (mut mixed, mut spread) = (0.0, 0.0);
    for (white, part) in samples.iter().enumerate() {
        for (_, v) in part {
            mixed += (v - mean) * (white as f64 - share);
            spread += (v - mean).powi(2);
        }
    }
    mixed / (spread * count * share * (1.0 - share)).sqrt().max(1e-12)
}
