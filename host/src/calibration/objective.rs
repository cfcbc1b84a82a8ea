//! α and κ of an objective: the same points seen through it and through the default one.
//!
//! A point p in focus at pixel P_I with the microscope at P_M is p = P_M + κ + α[A·P_I; 0], with α = 1 and κ = 0 for the
//! default objective. That one says where the points are; then p − P_M = α[A·P_I; 0] + κ is a scale and an offset.

use super::camera::{Options, two_answers};
use super::chain::Sensor;
use super::error::CalibrationError;
use super::geometry::{self, Span};
use super::robust::{Model, Settings, Solution, solve};
use super::samples::{ObjectiveSample, on_sensor};
use super::statistics::{self, StandardErrors};
use nalgebra::{Matrix2, Vector3};
use std::collections::BTreeMap;

/// An objective's α and κ.
#[derive(Clone, Debug)]
pub struct ObjectiveFit {
    /// Its name.
    pub name: String,
    /// Rows of the file, from 1, in the order of the solution's points.
    pub rows: Vec<usize>,
    /// Size of its pixel in default pixels.
    pub alpha: f64,
    /// κ, µm.
    pub kappa_um: Vector3<f64>,
    /// What the solver found, [A·P_I; 0] to p − P_M.
    pub solution: Solution<3>,
    /// Standard errors; `None` when the samples fit exactly by their number.
    pub standard_errors: Option<StandardErrors<3>>,
    /// Leave-one-out error of each inlier, µm.
    pub leave_one_out_um: Vec<Option<f64>>,
    /// [A·P_I; 0] of each sample, µm.
    pub image_um: Vec<Vector3<f64>>,
}

/// Solves every objective in the samples but the default one.
///
/// # Errors
/// [`CalibrationError`], naming the row, or the objective that is missing.
pub fn fit(
    samples: &[ObjectiveSample],
    default: &str,
    sensor: Sensor,
    a: &Matrix2<f64>,
    options: &Options,
) -> Result<Vec<ObjectiveFit>, CalibrationError> {
    on_sensor(sensor, samples.iter().map(|s| s.pixel))?;
    let in_um = |s: &ObjectiveSample| {
        let p = a * sensor.to_image(s.pixel).coordinates.xy();
        Vector3::new(p.x, p.y, 0.0)
    };
    let mut sightings: BTreeMap<&str, Vec<Vector3<f64>>> = BTreeMap::new();
    for sample in samples.iter().filter(|s| s.objective == default) {
        sightings.entry(&sample.point).or_default().push(sample.mic_um + in_um(sample));
    }
    if sightings.is_empty() {
        return Err(CalibrationError::Missing(format!(
            "no sample was taken through the default objective '{default}': see each point through it as well, or \
             name the default one with --default"
        )));
    }
    let place = |point: &str| sightings.get(point).map(|seen| seen.iter().sum::<Vector3<f64>>() / seen.len() as f64);
    let mut names: Vec<&str> = Vec::new();
    for name in samples.iter().map(|s| s.objective.as_str()).filter(|name| *name != default) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    if names.is_empty() {
        return Err(CalibrationError::Missing(format!(
            "all samples were taken through '{default}': see the same points through the objective to calibrate"
        )));
    }
    names.into_iter().map(|name| one(name, samples, &place, &in_um, default, options)).collect()
}

fn one(
    name: &str,
    samples: &[ObjectiveSample],
    place: &dyn Fn(&str) -> Option<Vector3<f64>>,
    in_um: &dyn Fn(&ObjectiveSample) -> Vector3<f64>,
    default: &str,
    options: &Options,
) -> Result<ObjectiveFit, CalibrationError> {
    let (mut rows, mut src, mut dst) = (Vec::new(), Vec::new(), Vec::new());
    for (i, sample) in samples.iter().enumerate().filter(|(_, s)| s.objective == name) {
        let known = place(&sample.point).ok_or_else(|| {
            CalibrationError::Missing(format!(
                "row {}: point '{}' was not seen through the default objective '{default}': see it through both",
                i + 1,
                sample.point
            ))
        })?;
        rows.push(i + 1);
        src.push(in_um(sample));
        dst.push(known - sample.mic_um);
    }
    if src.len() < 2 {
        return Err(CalibrationError::TooFew { what: "an objective", have: src.len(), need: 2 });
    }
    geometry::check(&src, Span { what: "picture", unit: "µm", least: 1.0, dimensions: 1 })?;
    let settings = Settings {
        tolerance: options.tolerance_um,
        seed: options.seed,
        estimator: options.estimator,
        ..Settings::new(Model::ScaleOffset)
    };
    let solution = solve(&src, &dst, &settings)?;
    if let Some(ambiguity) = &solution.ambiguity {
        return Err(CalibrationError::Ambiguous(two_answers(ambiguity, &solution.inliers)));
    }
    let alpha = solution.fit.map.linear[(0, 0)];
    if !(0.002..=500.0).contains(&alpha) {
        return Err(CalibrationError::Units(format!(
            "objective '{name}' would have pixels {alpha:.4} times the default one's: are mic columns in µm, image columns \
             in px, and did the points stay where they were?"
        )));
    }
    Ok(ObjectiveFit {
        name: name.into(),
        rows,
        alpha,
        kappa_um: solution.fit.map.shift,
        standard_errors: statistics::standard_errors(Model::ScaleOffset, &src, &solution),
        leave_one_out_um: statistics::leave_one_out(Model::ScaleOffset, &src, &dst, &solution.chosen()),
        image_um: src,
        solution,
    })
}
