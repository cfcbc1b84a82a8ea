//! Least squares of one smooth peak.
//!
//! Φ(v+x) = a + b·x − k·x² + d·x|x| + e·x⁴. Real peaks are lopsided (d), but a free d would cost four times the error of
//! the vertex, since x|x| looks like x; so d is held near 0 by a prior, as one more measurement. e is even: it costs the
//! vertex nothing and takes up the flanks' flattening.

use super::curve::{Curve, Place, magnitude};
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
    let mut normal = [[0.0; TERMS + 2]; TERMS];
    let (mut square, mut places) = (0.0, 0.0);
    for (_, cell) in curve.between(model.from, model.to) {
        let weight = f64::from(cell.frames);
        let x = (cell.x - vertex) / unit;
        let y = (cell.mean - reference) / model.sigma;
        let f = [1.0, x, x * x, x * magnitude(x), x * x * x * x];
        for i in 0..terms {
            let w = weight * f[i];
            for j in i..terms {
                normal[i][j] += w * f[j];
            }
            normal[i][TERMS] += w * y;
        }
        square += weight * y * y;
        places += 1.0;
    }
    for i in 0..terms {
        for j in 0..i {
            normal[i][j] = normal[j][i];
        }
    }
    let lopsided = terms > 3;
    if lopsided {
        let bend = model.bend.map_or(1.0, |b| b * unit * unit / model.sigma);
        normal[3][3] += 1.0 / (LOPSIDED * bend * LOPSIDED * bend);
    }
    let right: [f64; TERMS] = core::array::from_fn(|i| normal[i][TERMS]);
    // A second right-hand side gives the first element of the inverse: the variance of a.
    normal[0][TERMS + 1] = 1.0;
    let solved = eliminate(normal, terms)?;
    let coefficient = |i: usize| if i < terms { solved[i][TERMS] } else { 0.0 };
    let bend = -coefficient(2);
    let slope = coefficient(1);
    let explained: f64 = (0..terms).map(|i| coefficient(i) * right[i]).sum();
    Some(Fit {
        top: reference + model.sigma * (coefficient(0) + if bend > 0.0 { 0.25 * slope * slope / bend } else { 0.0 }),
        error: model.sigma * root(solved[0][TERMS + 1]),
        shift: if bend == 0.0 { 0.0 } else { 0.5 * slope / bend * unit },
        bend: bend * model.sigma / (unit * unit),
        misfit: square - explained,
        // The vertex was looked for, too; the prior gives most of its own term back.
        freedom: places - terms as f64 - 1.0 + if lopsided { 0.8 } else { 0.0 },
    })
}

/// Gauss-Jordan on the normal equations; `None` where they are singular.
fn eliminate(mut m: [[f64; TERMS + 2]; TERMS], terms: usize) -> Option<[[f64; TERMS + 2]; TERMS]> {
    for i in 0..terms {
        if m[i][i] <= 1e-12 {
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
