//! One paragraph that says whether a calibration is good, what was rejected, and what would make it better.

use crate::calibration::camera::CameraFit;
use crate::calibration::objective::ObjectiveFit;
use crate::calibration::registration::RegistrationFit;
use crate::calibration::robust::{Model, Solution};

/// A direction along which the points spread less than this share of the widest deserves more.
const NARROW: f64 = 0.25;

pub fn camera(fit: &CameraFit) -> String {
    let mut parts = vec![good(&fit.solution, &fit.leave_one_out_um)];
    parts.extend(rejected(&fit.solution, None));
    let (x, y) = fit.pixel_um();
    let mirrored = if fit.mirrored() { ", mirrored" } else { "" };
    parts.push(format!("a pixel is {x:.4} x {y:.4} µm, turned {:.2}°{mirrored}", fit.rotation_deg()));
    if fit.skew_deg().abs() > 0.5 {
        parts.push(format!("the picture's axes are {:.2}° off square", fit.skew_deg()));
    }
    let spread = |k: usize| deviation(fit.solution.chosen().iter().map(|&i| fit.image_px[i][k]));
    parts.extend(narrow(&[spread(0), spread(1)], "across the picture"));
    sentence(parts)
}

pub fn registration(fit: &RegistrationFit) -> String {
    let mut parts = vec![good(&fit.solution, &fit.leave_one_out_um)];
    parts.extend(rejected(&fit.solution, None));
    if fit.model == Model::Affine {
        let angles = fit.axis_angles_deg();
        let pairs = ["x and y", "y and z", "z and x"];
        let (worst, angle) = (0..3)
            .map(|k| (k, angles[k]))
            .max_by(|a, b| (a.1 - 90.0).abs().total_cmp(&(b.1 - 90.0).abs()))
            .unwrap_or((0, 90.0));
        if (angle - 90.0).abs() > 1.0 {
            parts.push(format!("axes {} lean {:.1}° from square", pairs[worst], (angle - 90.0).abs()));
        }
        for (axis, scale) in ["x", "y", "z"].into_iter().zip(fit.axis_scales()) {
            if (scale - 1.0).abs() > 0.02 {
                parts.push(format!("the {axis} axis moves {scale:.3} µm a µm: check its steps per mm"));
            }
        }
    }
    if fit.mirrored() {
        parts.push("the axes are left-handed (mirrored) in ref".into());
    }
    let chosen = fit.solution.chosen();
    let alone: Vec<String> = chosen
        .iter()
        .zip(&fit.leave_one_out_um)
        .filter(|(_, error)| error.is_none())
        .map(|(i, _)| (i + 1).to_string())
        .collect();
    if !alone.is_empty() && alone.len() < chosen.len() {
        parts.push(format!("an axis rests on row {} alone: take more samples along it", alone.join(", ")));
    }
    let spread = |k: usize| deviation(chosen.iter().map(|&i| fit.man_um[i][k]));
    parts.extend(narrow(&[spread(0), spread(1), spread(2)], "with the manipulator"));
    sentence(parts)
}

pub fn objective(fit: &ObjectiveFit) -> String {
    let mut parts = vec![good(&fit.solution, &fit.leave_one_out_um)];
    parts.extend(rejected(&fit.solution, Some(&fit.rows)));
    let k = fit.kappa_um;
    parts.push(format!(
        "its pixel is {:.4} default ones, it looks {:.1}, {:.1} µm aside and focuses {:.1} µm {}",
        fit.alpha,
        k.x,
        k.y,
        k.z.abs(),
        if k.z < 0.0 { "lower" } else { "higher" }
    ));
    sentence(parts)
}

/// How good, honestly: by what the samples predict of each other.
fn good<const D: usize>(solution: &Solution<D>, left_out: &[Option<f64>]) -> String {
    let worst = left_out.iter().try_fold(0.0, |max: f64, e| e.map(|e| max.max(e)));
    match worst {
        _ if left_out.iter().all(Option::is_none) => {
            "unchecked: as many samples as unknowns fit exactly, take at least two more".into()
        }
        Some(worst) => {
            format!("good to {:.1} µm (rms {:.2} µm over {} samples)", worst, solution.rms(), left_out.len())
        }
        None => format!("rms {:.2} µm over {} samples", solution.rms(), left_out.len()),
    }
}

fn rejected<const D: usize>(solution: &Solution<D>, rows: Option<&[usize]>) -> Option<String> {
    let name = |i: usize| rows.map_or(i + 1, |rows| rows[i]);
    let out: Vec<String> = (0..solution.inliers.len())
        .filter(|&i| !solution.inliers[i])
        .map(|i| {
            let off = solution.residuals[i].norm();
            let digits = if off < 9.95 { 1 } else { 0 };
            format!("{} ({off:.digits$} µm off)", name(i))
        })
        .collect();
    match out.len() {
        0 => None,
        1 => Some(format!("row {} rejected", out[0])),
        _ => Some(format!("rows {} rejected", out.join(", "))),
    }
}

/// Which axis to move further along.
fn narrow(spreads: &[f64], how: &str) -> Option<String> {
    let widest = spreads.iter().copied().fold(0.0, f64::max);
    let (axis, least) = spreads.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1))?;
    let name = ["x", "y", "z"][axis.min(2)];
    (*least < NARROW * widest).then(|| format!("move further in {name} {how} to know that axis better"))
}

fn deviation(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let n = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / n;
    (values.map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt()
}

fn sentence(parts: Vec<String>) -> String {
    let text = parts.join("; ");
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| format!("{}{}.", first.to_uppercase(), letters.as_str()))
}
