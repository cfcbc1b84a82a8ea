//! A focus curve as a picture and as a table.

use super::{Sample, Scanned};
use parfocal_protocol::autofocus::Outcome;
use plotters::prelude::*;
use std::fmt::Write as _;
use std::path::Path;
use thiserror::Error;

/// A file that could not be written.
#[derive(Debug, Error)]
#[error("{path}: cannot be written: {reason}")]
pub struct PlotError {
    path: String,
    reason: String,
}

/// The samples as CSV, in the order taken: `z_um,phi`.
pub fn csv(samples: &[Sample]) -> String {
    samples.iter().fold(String::from("z_um,phi\n"), |mut text, s| {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{},{}", s.z.0, s.phi.0);
        text
    })
}

/// Draws Φ over z, the samples as dots joined along z, the result as a line.
///
/// # Errors
/// [`PlotError`] when the file cannot be written.
pub fn svg(path: &Path, scanned: &Scanned, measure: &str) -> Result<(), PlotError> {
    draw(path, scanned, measure)
        .map_err(|reason| PlotError { path: path.display().to_string(), reason: reason.to_string() })
}

fn draw(path: &Path, scanned: &Scanned, measure: &str) -> Result<(), Box<dyn std::error::Error>> {
    let samples = &scanned.samples;
    let span = |value: fn(&Sample) -> f64| {
        let (low, high) =
            samples.iter().map(value).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        if high > low { (low, high) } else { (low.min(0.0) - 1.0, high.max(0.0) + 1.0) }
    };
    let ((z0, z1), (p0, p1)) = (span(|s| s.z.0), span(|s| s.phi.0));
    let (zm, pm) = (0.04 * (z1 - z0), 0.06 * (p1 - p0));
    let area = SVGBackend::new(path, (900, 520)).into_drawing_area();
    area.fill(&WHITE)?;
    let report = &scanned.report;
    let caption = match report.outcome {
        Outcome::Focused => format!("focused at {:.2} µm", report.best.micrometres().0),
        Outcome::Refused(why) => format!("refused: {}", crate::link::explain::scan_refusal(why)),
    };
    let mut chart = ChartBuilder::on(&area)
        .caption(caption, ("sans-serif", 22))
        .margin(14)
        .x_label_area_size(46)
        .y_label_area_size(84)
        .build_cartesian_2d(z0 - zm..z1 + zm, p0 - pm..p1 + pm)?;
    chart
        .configure_mesh()
        .x_desc("z, µm")
        .y_desc(format!("Φ ({measure})"))
        .label_style(("sans-serif", 15))
        .axis_desc_style(("sans-serif", 17))
        .light_line_style(TRANSPARENT)
        .bold_line_style(RGBColor(225, 225, 225))
        .y_label_formatter(&|v| format!("{v:.3e}"))
        .draw()?;
    let blue = RGBColor(31, 98, 173);
    let mut curve: Vec<(f64, f64)> = samples.iter().map(|s| (s.z.0, s.phi.0)).collect();
    curve.sort_by(|a, b| a.0.total_cmp(&b.0));
    chart.draw_series(LineSeries::new(curve, blue.mix(0.5)))?;
    chart.draw_series(samples.iter().map(|s| Circle::new((s.z.0, s.phi.0), 2, blue.filled())))?;
    if report.outcome == Outcome::Focused {
        let best = report.best.micrometres().0;
        let line = [(best, p0 - pm), (best, p1 + pm)];
        chart.draw_series(LineSeries::new(line, RGBColor(200, 40, 40).stroke_width(2)))?;
    }
    area.present()?;
    Ok(())
}
