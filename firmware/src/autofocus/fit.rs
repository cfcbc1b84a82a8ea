//! Least squares of one smooth peak.
//!
//! Φ(v+x) = a + b·x − k·x² + d·x|x| + e·x⁴. Real peaks are lopsided (d), but a free d would cost four times the error of
//! the vertex, since x|x| looks like x; so d is held near 0 by a prior, as one more measurement. e is even: it costs the
//! vertex nothing and takes up the flanks' flattening.

use super::curve::{Cell, Curve, Place};
use super::noise::root;

/// How much the curvatures of the two sides differ, relative to their mean: standard deviation of the prior.
const LOPSIDED: f64 = 0.2;

const TERMS: usize = 5;

/// What to fit.
#[derive(Clone, Copy, Debug)]
pub struct Model {
    /// First place of the window.
    pub from: Place,
    /// Last place of the window.
    pub to: Place,
    /// Standard deviation of one frame.
    pub sigma: f64,
    /// The curvature k as far as it is known, per place², for the prior of the lopsidedness.
    pub bend: Option<f64>,
}

/// A fitted peak.
#[derive(Clone, Copy, Debug)]
pub struct Fit {
    /// Its height.
    pub top: f64,
    /// Standard error of the height.
    pub error: f64,
    /// From the assumed to the fitted vertex, in places.
    pub shift: f64,
    /// Curvature k, per place².
    pub bend: f64,
    /// χ² of what is left.
    pub misfit: f64,
    /// Its mean if the model is right.
    pub freedom: f64,
}

/// Fits a peak whose vertex is near `vertex`; `None` where the places do not determine it.
pub fn smooth_peak(curve: &Curve, model: &Model, vertex: f64) -> Option<Fit> {
    let unit = 0.5 * f64::from(model.to.0 - model.from.0);
    let reference = curve.between(model.from, model.to).next()?.1.mean;
    // Few places carry few terms.
    let terms = match model.to.0 - model.from.0 {
        ..8 => 3,
        8..12 => 4,
        _ => TERMS,
    };
    // Differences in f64; then the sums in f32, which the board's FPU has.
    let (per_unit, per_sigma) = (1.0 / unit, 1.0 / model.sigma);
    let scaled = |cell: &Cell| {
        let x = ((cell.x - vertex) * per_unit) as f32;
        let y = ((cell.mean - reference) * per_sigma) as f32;
        let square = x * x;
        (f32::from(cell.frames), [1.0, x, square, if x < 0.0 { -square } else { square }, square * square], y)
    };
    let mut normal = [[0.0f32; TERMS + 2]; TERMS];
    let mut places = 0.0;
    for (_, cell) in curve.between(model.from, model.to) {
        let (weight, f, y) = scaled(&cell);
        for i in 0..terms {
            let w = weight * f[i];
            for j in i..terms {
                normal[i][j] += w * f[j];
            }
            normal[i][TERMS] += w * y;
        }
        places += 1.0;
    }
    let upper = normal;
    for (i, row) in normal.iter_mut().enumerate().take(terms) {
        for (j, value) in row.iter_mut().enumerate().take(i) {
            *value = upper[j][i];
        }
    }
    let lopsided = terms > 3;
    if lopsided {
        let bend = model.bend.map_or(1.0, |b| b * unit * unit / model.sigma);
        normal[3][3] += (1.0 / (LOPSIDED * bend * LOPSIDED * bend)) as f32;
    }
    // A second right-hand side gives the first element of the inverse: the variance of a.
    normal[0][TERMS + 1] = 1.0;
    let solved = eliminate(normal, terms)?;
    let fitted: [f32; TERMS] = core::array::from_fn(|i| if i < terms { solved[i][TERMS] } else { 0.0 });
    let mut misfit = 0.0f32;
    for (_, cell) in curve.between(model.from, model.to) {
        let (weight, f, y) = scaled(&cell);
        let left = f.iter().zip(&fitted).fold(y, |left, (f, c)| left - f * c);
        misfit += weight * left * left;
    }
    let [height, slope, bend] = [fitted[0], fitted[1], -fitted[2]].map(f64::from);
    Some(Fit {
        top: reference + model.sigma * (height + if bend > 0.0 { 0.25 * slope * slope / bend } else { 0.0 }),
        error: model.sigma * root(f64::from(solved[0][TERMS + 1])),
        shift: if bend == 0.0 { 0.0 } else { 0.5 * slope / bend * unit },
        bend: bend * model.sigma / (unit * unit),
        misfit: f64::from(misfit),
        // The vertex was looked for, too; the prior gives most of its own term back.
        freedom: places - terms as f64 - 1.0 + if lopsided { 0.8 } else { 0.0 },
    })
}

/// Gauss-Jordan on the normal equations; `None` where they are singular.
fn eliminate(mut m: [[f32; TERMS + 2]; TERMS], terms: usize) -> Option<[[f32; TERMS + 2]; TERMS]> {
    for i in 0..terms {
        if m[i][i] <= 1e-6 {
            return None;
        }
        let inverse = 1.0 / m[i][i];
        for value in &mut m[i][i..] {
            *value *= inverse;
        }
        let pivot = m[i];
        for (r, row) in m.iter_mut().enumerate().take(terms) {
            if r != i {
                let factor = row[i];
                for (value, p) in row[i..].iter_mut().zip(&pivot[i..]) {
                    *value -= factor * p;
                }
            }
        }
    }
    Some(m)
}
