//! What a calibration is worth: a plain verdict, parameters with standard errors, every residual, pictures.

mod pictures;
mod verdict;

use super::camera::CameraFit;
use super::chain::Sensor;
use super::objective::ObjectiveFit;
use super::registration::RegistrationFit;
use super::robust::Solution;
use nalgebra::{Matrix2, SVector, Vector2};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A calibration's report.
#[derive(Clone, Debug)]
pub struct Report {
    /// What was calibrated.
    pub title: String,
    /// One paragraph for a person.
    pub verdict: String,
    /// Name, value, and standard error where there is one.
    pub parameters: Vec<(String, String)>,
    /// Header of the residuals' table.
    columns: Vec<&'static str>,
    /// One a sample.
    residuals: Vec<Vec<String>>,
    /// File name, caption, SVG.
    pictures: Vec<(&'static str, &'static str, String)>,
}

/// Why a report was not written.
#[derive(Debug, Error)]
pub enum ReportError {
    /// The folder cannot be written.
    #[error("cannot write the report's file {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

impl Report {
    /// Verdict and parameters, for the terminal.
    pub fn text(&self) -> String {
        let width = self.parameters.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
        let mut text = format!("{}\n", self.title);
        for (name, value) in &self.parameters {
            let _ = writeln!(text, "  {name:<width$}  {value}");
        }
        let _ = writeln!(text, "{}", self.verdict);
        text
    }

    /// Writes `report.md`, `residuals.csv` and the pictures.
    ///
    /// # Errors
    /// [`ReportError::Write`] with the file.
    pub fn write(&self, folder: &Path) -> Result<(), ReportError> {
        let put = |name: &str, text: &str| {
            let path = folder.join(name);
            std::fs::write(&path, text).map_err(|source| ReportError::Write { path, source })
        };
        for (name, _, svg) in &self.pictures {
            put(name, svg)?;
        }
        put(
            "residuals.csv",
            &lines(std::iter::once(self.columns.join(",")).chain(self.residuals.iter().map(|r| r.join(",")))),
        )?;
        put("report.md", &self.markdown())
    }

    fn markdown(&self) -> String {
        let table = |header: &[&str], rows: &mut dyn Iterator<Item = Vec<String>>| {
            let line = |cells: &[String]| format!("| {} |", cells.join(" | "));
            let header: Vec<String> = header.iter().map(|h| (*h).into()).collect();
            let rule: Vec<String> = header.iter().map(|_| "---".into()).collect();
            lines([line(&header), line(&rule)].into_iter().chain(rows.map(|row| line(&row))))
        };
        let parameters = table(
            &["parameter", "value"],
            &mut self.parameters.iter().map(|(name, value)| vec![name.clone(), value.clone()]),
        );
        let residuals = table(&self.columns, &mut self.residuals.iter().cloned());
        let pictures: String =
            self.pictures.iter().map(|(name, caption, _)| format!("![{caption}]({name})\n\n{caption}\n\n")).collect();
        format!("# {}\n\n{}\n\n{parameters}\n{pictures}## Residuals\n\n{residuals}", self.title, self.verdict)
    }
}

fn lines(lines: impl Iterator<Item = String>) -> String {
    lines.fold(String::new(), |text, line| text + &line + "\n")
}

/// A camera's report.
pub fn camera(fit: &CameraFit, sensor: Sensor) -> Report {
    let (x, y) = fit.pixel_um();
    let m = &fit.matrix_um_per_px;
    let mut parameters: Vec<(String, String)> = [(0, 0), (0, 1), (1, 0), (1, 1)]
        .map(|(r, c)| {
            (format!("A{}{}", r + 1, c + 1), with_error(m[(r, c)], fit.standard_errors.map(|e| e[(r, c)]), 5, "µm/px"))
        })
        .into();
    parameters.extend([
        ("pixel".into(), format!("{x:.4} x {y:.4} µm")),
        ("rotation".into(), format!("{:.3}°", fit.rotation_deg())),
        ("skew".into(), format!("{:.3}°", fit.skew_deg())),
        ("mirrored".into(), if fit.mirrored() { "yes" } else { "no" }.into()),
        ("rms".into(), format!("{:.3} µm, {:.3} px", fit.solution.rms(), fit.rms_px())),
    ]);
    parameters.extend(common(&fit.solution, &fit.leave_one_out_um));
    let inverse = fit.solution.fit.map.linear.try_inverse().unwrap_or_else(Matrix2::zeros);
    let residuals_px: Vec<Vector2<f64>> = fit.solution.residuals.iter().map(|r| inverse * r).collect();
    let size = Vector2::new(f64::from(sensor.width_px), f64::from(sensor.height_px));
    Report {
        title: "Camera calibration".into(),
        verdict: verdict::camera(fit),
        parameters,
        columns: vec!["row", "image_x_px", "image_y_px", "dx_um", "dy_um", "error_um", "error_px", "used"],
        residuals: table(&fit.solution, None, |i| {
            vec![
                format!("{:.2}", fit.image_px[i].x + (size.x - 1.0) / 2.0),
                format!("{:.2}", fit.image_px[i].y + (size.y - 1.0) / 2.0),
            ]
        })
        .into_iter()
        .zip(&residuals_px)
        .map(|(mut row, px)| {
            row.insert(row.len() - 1, format!("{:.3}", px.norm()));
            row
        })
        .collect(),
        pictures: vec![
            (
                "picture.svg",
                "Where the point was seen, and how far off the map puts it (not to scale); crosses were rejected.",
                pictures::vectors(&pictures::Vectors {
                    title: "Residuals in the picture",
                    unit: "px",
                    points: &fit.image_px,
                    errors: &residuals_px,
                    inliers: &fit.solution.inliers,
                    frame: Some(size),
                    down: true,
                }),
            ),
            (
                "residuals.svg",
                "Residuals of every sample, axis by axis; dashed: the tolerance.",
                pictures::residuals(&fit.solution),
            ),
        ],
    }
}

/// A registration's report.
pub fn registration(fit: &RegistrationFit) -> Report {
    let transform = fit.transform();
    let [xy, yz, zx] = fit.axis_angles_deg();
    let scales = fit.axis_scales();
    let mut parameters: Vec<(String, String)> = Vec::new();
    for r in 0..3 {
        for c in 0..3 {
            let error = fit.standard_errors.map(|e| e.linear[(r, c)]);
            parameters.push((format!("T{}{}", r + 1, c + 1), with_error(transform.linear()[(r, c)], error, 5, "")));
        }
    }
    let shift = transform.shift();
    parameters.extend([
        ("shift".into(), format!("{:.2}, {:.2}, {:.2} µm", shift.x, shift.y, shift.z)),
        ("axis angles".into(), format!("{xy:.2}° xy, {yz:.2}° yz, {zx:.2}° zx")),
        ("axis scales".into(), format!("{:.4}, {:.4}, {:.4}", scales[0], scales[1], scales[2])),
        ("mirrored".into(), if fit.mirrored() { "yes" } else { "no" }.into()),
        ("rms".into(), format!("{:.3} µm", fit.solution.rms())),
    ]);
    parameters.extend(common(&fit.solution, &fit.leave_one_out_um));
    let centre = fit.ref_um.iter().sum::<nalgebra::Vector3<f64>>() / fit.ref_um.len() as f64;
    let points: Vec<_> = fit.ref_um.iter().map(|p| (p - centre).xy()).collect();
    let errors: Vec<_> = fit.solution.residuals.iter().map(|r| r.xy()).collect();
    Report {
        title: format!("Registration, {} model", fit.model.name()),
        verdict: verdict::registration(fit),
        parameters,
        columns: vec!["row", "ref_x_um", "ref_y_um", "ref_z_um", "dx_um", "dy_um", "dz_um", "error_um", "used"],
        residuals: table(&fit.solution, None, |i| fit.ref_um[i].iter().map(|v| format!("{v:.2}")).collect()),
        pictures: vec![
            (
                "picture.svg",
                "The tips from above, in ref, and how far off the map puts them (not to scale); crosses were rejected.",
                pictures::vectors(&pictures::Vectors {
                    title: "Residuals from above",
                    unit: "µm",
                    points: &points,
                    errors: &errors,
                    inliers: &fit.solution.inliers,
                    frame: None,
                    down: false,
                }),
            ),
            (
                "residuals.svg",
                "Residuals of every sample, axis by axis; dashed: the tolerance.",
                pictures::residuals(&fit.solution),
            ),
            (
                "axes.svg",
                "The manipulator's axes (colours) in ref (grey), one unit long.",
                pictures::axes(transform.linear()),
            ),
        ],
    }
}

/// An objective's report.
pub fn objective(fit: &ObjectiveFit, default: &str) -> Report {
    let error = |which: fn(&super::statistics::StandardErrors<3>) -> f64| fit.standard_errors.as_ref().map(which);
    let mut parameters = vec![("alpha".into(), with_error(fit.alpha, error(|e| e.linear[(0, 0)]), 5, ""))];
    for (name, value) in ["kappa x", "kappa y", "kappa z"].into_iter().zip(fit.kappa_um.iter()) {
        parameters.push((name.into(), with_error(*value, error(|e| e.centre), 3, "µm")));
    }
    parameters.push(("rms".into(), format!("{:.3} µm", fit.solution.rms())));
    parameters.extend(common(&fit.solution, &fit.leave_one_out_um));
    let points: Vec<_> = fit.image_um.iter().map(|p| p.xy()).collect();
    let errors: Vec<_> = fit.solution.residuals.iter().map(|r| r.xy()).collect();
    Report {
        title: format!("Objective {} against {default}", fit.name),
        verdict: verdict::objective(fit),
        parameters,
        columns: vec!["row", "x_um", "y_um", "dx_um", "dy_um", "dz_um", "error_um", "used"],
        residuals: table(&fit.solution, Some(&fit.rows), |i| {
            fit.image_um[i].xy().iter().map(|v| format!("{v:.2}")).collect()
        }),
        pictures: vec![
            (
                "picture.svg",
                "Where the points were seen, and how far off the map puts them (not to scale); crosses were rejected.",
                pictures::vectors(&pictures::Vectors {
                    title: "Residuals in the picture",
                    unit: "µm",
                    points: &points,
                    errors: &errors,
                    inliers: &fit.solution.inliers,
                    frame: None,
                    down: false,
                }),
            ),
            (
                "residuals.svg",
                "Residuals of every sample, axis by axis; dashed: the tolerance.",
                pictures::residuals(&fit.solution),
            ),
        ],
    }
}

/// `value ± error unit`.
fn with_error(value: f64, error: Option<f64>, digits: usize, unit: &str) -> String {
    let error = error.map_or(String::new(), |e| format!(" ± {e:.digits$}"));
    format!("{value:.digits$}{error} {unit}").trim_end().to_owned()
}

/// What all reports say of their solution.
fn common<const D: usize>(solution: &Solution<D>, left_out: &[Option<f64>]) -> Vec<(String, String)> {
    let worst = left_out.iter().try_fold(0.0, |max: f64, e| e.map(|e| max.max(e)));
    let used = solution.chosen().len();
    vec![
        ("largest residual".into(), format!("{:.3} µm", solution.max())),
        ("leave-one-out, largest".into(), worst.map_or("one sample carries an axis".into(), |e| format!("{e:.3} µm"))),
        ("tolerance".into(), format!("{:.3} µm", solution.tolerance)),
        ("samples used".into(), format!("{used} of {}", solution.inliers.len())),
        (
            "subsets tried".into(),
            format!("{}{}", solution.draws, if solution.exhaustive { " (all)" } else { " (random)" }),
        ),
    ]
}

/// The residuals' table: row, what `place` says, components, length, whether used.
fn table<const D: usize>(
    solution: &Solution<D>,
    rows: Option<&[usize]>,
    place: impl Fn(usize) -> Vec<String>,
) -> Vec<Vec<String>> {
    let line = |(i, r): (usize, &SVector<f64, D>)| {
        let mut row = vec![rows.map_or(i + 1, |rows| rows[i]).to_string()];
        row.extend(place(i));
        row.extend(r.iter().map(|v| format!("{v:.3}")));
        row.push(format!("{:.3}", r.norm()));
        row.push(if solution.inliers[i] { "yes" } else { "no" }.into());
        row
    };
    solution.residuals.iter().enumerate().map(line).collect()
}
