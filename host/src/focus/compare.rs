//! All measures over one focal stack: which of them finds the focus, and how easily.

use super::{FocusError, Measure, measure, shape::Shape};
use crate::picture::View;
use parfocal_protocol::units::{FocusValue, Micrometres};
use std::time::Instant;

/// One measure's curve over a stack, and what it is worth.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Row {
    /// The measure.
    pub measure: Measure,
    /// Φ of each plane.
    pub phi: Vec<f64>,
    /// The curve's shape; `None` for a flat one.
    #[serde(flatten)]
    pub shape: Option<Shape>,
    /// Distance of the peak from the known truth.
    pub error_um: Option<f64>,
    /// Median time that one plane took.
    pub ms: f64,
}

/// Measures every plane with every measure. `truth` is the z that is known to be in focus.
///
/// # Errors
/// [`FocusError`] for a region that is too small for one of them.
pub fn compare(planes: &[View<'_>], z: &[Micrometres], truth: Option<Micrometres>) -> Result<Vec<Row>, FocusError> {
    Measure::ALL.into_iter().map(|m| row(m, planes, z, truth)).collect()
}

fn row(m: Measure, planes: &[View<'_>], z: &[Micrometres], truth: Option<Micrometres>) -> Result<Row, FocusError> {
    let (mut phi, mut times): (Vec<FocusValue>, Vec<f64>) = (Vec::new(), Vec::new());
    for plane in planes {
        let start = Instant::now();
        phi.push(measure(*plane, m)?);
        times.push(start.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    let shape = Shape::of(z, &phi);
    let error_um = shape.as_ref().zip(truth).map(|(s, t)| (s.peak_um - t.0).abs());
    let ms = times.get(times.len() / 2).copied().unwrap_or(0.0);
    Ok(Row { measure: m, phi: phi.iter().map(|p| p.0).collect(), shape, error_um, ms })
}

/// The measure to use on pictures like these, and why.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Recommendation {
    /// The measure; `None` when no curve has a peak inside the stack.
    pub measure: Option<Measure>,
    /// The reason, for a person.
    pub words: String,
}

/// Chooses among the measures whose curve falls to half its height on both sides inside the stack: first what ends nearest to
/// `truth`, if it is known (one plane more or less is no difference), then what is hardest to be trapped in, then what stands out most
/// from its noise. Of a curve with two lobes the valley counts if the truth lies there.
pub fn recommend(rows: &[Row], z_step: Micrometres, truth: Option<Micrometres>) -> Recommendation {
    let candidates = rows.iter().filter_map(|row| {
        let shape = row.shape.as_ref().filter(|s| !s.at_edge && s.width_um.is_some())?;
        let focus = Focus::of(shape, z_step, truth);
        Some((row, shape, focus, focus.rank(shape, z_step)))
    });
    let Some((row, shape, focus, _)) = candidates.min_by(|a, b| a.3.total_cmp(&b.3)) else {
        let words = "No measure has a whole peak inside this stack: the focus lies at its edge or beyond, or the region is \
                     blank. Take a stack that goes further, or choose a region with texture.";
        return Recommendation { measure: None, words: words.into() };
    };
    let mut words = match focus.in_valley {
        false => format!("Use {}: its peak is at {:.2} µm", row.measure, focus.at_um),
        true => format!(
            "Use {} as for a phase object: its valley between two lobes is at {:.2} µm",
            row.measure, focus.at_um
        ),
    };
    if let Some(error) = focus.error_um {
        words += &format!(", {error:.2} µm from the known focus");
    }
    words += &match (shape.other_maxima, shape.farthest_maximum_um) {
        (n, Some(far)) if n > 0 => format!("; {n} other {}, up to {far:.1} µm away", plural(n, "maximum", "maxima")),
        _ => "; no other maximum".into(),
    };
    if let Some(noise) = shape.noise {
        words += &format!("; noise {:.2} % of its height", 100.0 * noise);
    }
    let us = 1e3 * row.ms;
    words += &format!("; {us:.*} µs a frame.", usize::from(us < 10.0));
    if let (Some(valley), false) = (shape.valley_um, focus.in_valley) {
        words += &format!(
            " It has a second lobe of similar height: if the object is unstained, its focus is the valley at {valley:.2} µm."
        );
    }
    if focus.error_um > Some(3.0 * z_step.0.abs()) {
        words +=
            " No measure comes within three planes of the known focus: choose a region around what shall be in focus.";
    }
    Recommendation { measure: Some(row.measure), words }
}

/// What a curve takes for the focus.
#[derive(Clone, Copy)]
struct Focus {
    at_um: f64,
    error_um: Option<f64>,
    in_valley: bool,
}

impl Focus {
    fn of(shape: &Shape, z_step: Micrometres, truth: Option<Micrometres>) -> Self {
        let error = |z: f64| truth.map(|t| (z - t.0).abs());
        let peak = Self { at_um: shape.peak_um, error_um: error(shape.peak_um), in_valley: false };
        match shape.valley_um {
            Some(z) if error(z) < peak.error_um && error(z) <= Some(1.5 * z_step.0.abs()) => {
                Self { at_um: z, error_um: error(z), in_valley: true }
            }
            _ => peak,
        }
    }

    /// Lower is better. The terms are of different importance, not of different unit.
    fn rank(&self, shape: &Shape, z_step: Micrometres) -> f64 {
        let planes_off = (self.error_um.unwrap_or(0.0) / z_step.0.abs() - 1.0).max(0.0);
        let traps = shape.other_maxima as f64 * (1.0 + shape.highest_other.unwrap_or(0.0));
        1e4 * planes_off + 1e1 * traps + 1e2 * shape.noise.unwrap_or(0.0)
    }
}

fn plural(n: usize, one: &'static str, many: &'static str) -> &'static str {
    if n == 1 { one } else { many }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Picture;

    /// Stripes whose contrast is largest at plane `best`.
    fn stack(best: usize) -> Vec<Picture> {
        (0..21usize)
            .map(|plane| {
                let contrast = 100.0 / (1.0 + (plane.abs_diff(best) as f64 / 3.0).powi(2));
                let grey = |i: usize| (128.0 + contrast * ((i % 32) as f64 * 0.9).sin()) as u8;
                Picture::grey8(32, 8, (0..256).map(grey).collect()).unwrap()
            })
            .collect()
    }

    fn compared(best: usize) -> (Vec<Row>, Recommendation) {
        let stack = stack(best);
        let views: Vec<_> = stack.iter().map(Picture::view).collect();
        let z: Vec<_> = (0..21).map(|k| Micrometres(2.0 * f64::from(k))).collect();
        let rows = compare(&views, &z, Some(Micrometres(2.0 * best as f64))).unwrap();
        let recommendation = recommend(&rows, Micrometres(2.0), Some(Micrometres(2.0 * best as f64)));
        (rows, recommendation)
    }

    #[test]
    fn measures_of_contrast_find_the_plane_of_most_contrast() {
        let (rows, recommendation) = compared(8);
        assert_eq!(rows.len(), Measure::ALL.len());
        for row in rows.iter().filter(|r| r.measure != Measure::Entropy) {
            assert_eq!(row.error_um, Some(0.0), "{}", row.measure);
            assert_eq!(row.shape.as_ref().unwrap().other_maxima, 0, "{}", row.measure);
        }
        assert!(recommendation.measure.is_some());
        assert!(recommendation.words.contains("16.00 µm, 0.00 µm from"), "{}", recommendation.words);
    }

    #[test]
    fn a_focus_outside_the_stack_gets_no_recommendation() {
        let (_, recommendation) = compared(0);
        assert_eq!(recommendation.measure, None);
        assert!(recommendation.words.contains("edge"), "{}", recommendation.words);
    }
}
