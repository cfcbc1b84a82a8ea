//! Whether positions span enough, and which way to move when they do not.

use super::error::CalibrationError;
use nalgebra::{DMatrix, SVector};

/// What the positions are of, for the refusal.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    /// "manipulator", "microscope" …
    pub what: &'static str,
    /// µm or px.
    pub unit: &'static str,
    /// Smallest extent that makes sense.
    pub least: f64,
    /// Dimensions that must be spanned.
    pub dimensions: usize,
}

/// A direction is spanned when the spread along it is at least this share of the largest.
const FLAT: f64 = 2e-3;

/// Refuses repeated positions, and such as lie together, on a line or in a plane.
pub fn check<const D: usize>(points: &[SVector<f64, D>], span: Span) -> Result<(), CalibrationError> {
    let mean = points.iter().sum::<SVector<f64, D>>() / points.len() as f64;
    let matrix = DMatrix::from_fn(D, points.len(), |r, c| points[c][r] - mean[r]);
    let svd = matrix.svd(true, false);
    let mut order: Vec<usize> = (0..svd.singular_values.len()).collect();
    order.sort_by(|a, b| svd.singular_values[*b].total_cmp(&svd.singular_values[*a]));
    let spread = |k: usize| order.get(k).map_or(0.0, |&i| svd.singular_values[i] / (points.len() as f64).sqrt());
    let extent = (0..D)
        .map(|k| {
            let range = |f: fn(f64, f64) -> f64, from| points.iter().map(|p| p[k]).fold(from, f);
            range(f64::max, f64::NEG_INFINITY) - range(f64::min, f64::INFINITY)
        })
        .fold(0.0, f64::max);
    if extent < span.least {
        return Err(CalibrationError::TooClose { what: span.what, extent, unit: span.unit, least: span.least });
    }
    repeated(points, span)?;
    let Some(thin) = (1..span.dimensions).find(|&k| spread(k) < FLAT * spread(0)) else { return Ok(()) };
    let along = match (&svd.u, order.get(span.dimensions - 1)) {
        (Some(u), Some(&last)) => axis_name(u.column(last).iter().copied().enumerate()),
        _ => "another axis".into(),
    };
    let on = if thin == 1 { "on a line" } else { "in a plane" };
    Err(CalibrationError::Flat { what: span.what, on, across: spread(thin), unit: span.unit, along })
}

/// Positions closer than a hundredth of the least extent are the same.
fn repeated<const D: usize>(points: &[SVector<f64, D>], span: Span) -> Result<(), CalibrationError> {
    for (i, p) in points.iter().enumerate() {
        if let Some(j) = points[..i].iter().position(|q| (p - q).norm() < 0.01 * span.least) {
            return Err(CalibrationError::Repeated { first: j + 1, second: i + 1, what: span.what });
        }
    }
    Ok(())
}

/// The axis a direction is nearest to.
fn axis_name(direction: impl Iterator<Item = (usize, f64)>) -> String {
    let nearest = direction.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    nearest.map_or("another axis".into(), |(k, _)| ["x", "y", "z"][k.min(2)].into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    const SPAN: Span = Span { what: "manipulator", unit: "µm", least: 10.0, dimensions: 3 };

    fn refusal(points: &[[f64; 3]]) -> String {
        let points: Vec<_> = points.iter().map(|p| Vector3::from(*p)).collect();
        check(&points, SPAN).unwrap_err().to_string()
    }

    #[test]
    fn it_says_what_to_move() {
        let flat = [[0., 0., 0.], [100., 0., 0.], [0., 100., 0.], [100., 100., 0.], [50., 20., 0.]];
        assert!(refusal(&flat).contains("in a plane") && refusal(&flat).contains("along z"));
        let line = [[0., 0., 0.], [50., 50., 0.], [100., 100., 0.], [75., 75., 0.]];
        assert!(refusal(&line).contains("on a line"));
        let twice = [[0., 0., 0.], [100., 0., 0.], [0., 100., 0.], [0., 0., 100.], [100., 0., 0.05]];
        assert!(refusal(&twice).contains("rows 2 and 5"));
        assert!(refusal(&[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]]).contains("span only 1"));
    }

    #[test]
    fn points_along_one_axis_at_a_time_are_enough() {
        let points: Vec<_> = [[0., 0., 0.], [100., 0., 0.], [0., 50., 0.], [0., 0., 900.]].map(Vector3::from).into();
        assert!(check(&points, SPAN).is_ok());
    }
}
