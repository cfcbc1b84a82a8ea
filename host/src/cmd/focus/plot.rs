//! Focus curves as small charts, one a measure, in one SVG file.

use parfocal::focus::compare::Row;
use parfocal_protocol::units::Micrometres;
use plotters::coord::Shift;
use plotters::prelude::*;
use std::path::Path;

const COLUMNS: usize = 4;
const CHART: (u32, u32) = (300, 210);
const FONT: &str = "sans-serif";
const CURVE: RGBColor = RGBColor(0x1f, 0x5f, 0xa8);
const PEAK: RGBColor = RGBColor(0xc0, 0x39, 0x2b);
const TRUTH: RGBColor = RGBColor(0x2e, 0x8b, 0x57);
const GRID: RGBColor = RGBColor(0xe4, 0xe6, 0xea);
const INK: RGBColor = RGBColor(0x33, 0x38, 0x40);

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Draws every row's curve, scaled to its own height, its peak and the known focus.
pub fn curves(file: &Path, rows: &[Row], z: &[Micrometres], truth: Option<Micrometres>) -> anyhow::Result<()> {
    draw(file, rows, z, truth).map_err(|e| anyhow::anyhow!("{e}"))
}

fn draw(file: &Path, rows: &[Row], z: &[Micrometres], truth: Option<Micrometres>) -> Result<(), Failure> {
    // One cell more than curves: the legend.
    let lines = (rows.len() + 1).div_ceil(COLUMNS);
    let size = (CHART.0 * COLUMNS as u32, CHART.1 * lines as u32);
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        area.fill(&WHITE).map_err(plain)?;
        let cells = area.split_evenly((lines, COLUMNS));
        for (row, cell) in rows.iter().zip(&cells) {
            chart(cell, row, z, truth)?;
        }
        if let Some(cell) = cells.get(rows.len()) {
            legend(cell, truth.is_some())?;
        }
        area.present().map_err(plain)?;
    }
    std::fs::write(file, svg)?;
    Ok(())
}

fn plain(error: impl std::fmt::Display) -> Failure {
    error.to_string().into()
}

fn chart(
    cell: &DrawingArea<SVGBackend<'_>, Shift>,
    row: &Row,
    z: &[Micrometres],
    truth: Option<Micrometres>,
) -> Result<(), Failure> {
    let (first, last) = (z.first().map_or(0.0, |z| z.0), z.last().map_or(1.0, |z| z.0));
    let low = row.phi.iter().copied().fold(f64::INFINITY, f64::min);
    let height = row.phi.iter().copied().fold(f64::NEG_INFINITY, f64::max) - low;
    let scaled = |phi: f64| if height > 0.0 { (phi - low) / height } else { 0.0 };
    let mut chart = ChartBuilder::on(cell)
        .caption(row.measure.name(), (FONT, 15).into_font().color(&INK))
        .margin(8)
        .margin_right(18)
        .x_label_area_size(34)
        .y_label_area_size(40)
        .build_cartesian_2d(first..last.max(first + f64::EPSILON), -0.03..1.08)
        .map_err(plain)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(INK)
        .x_labels(6)
        .y_labels(3)
        .x_desc("z / µm")
        .y_desc("Φ, scaled")
        .label_style((FONT, 11).into_font().color(&INK))
        .draw()
        .map_err(plain)?;
    if let Some(Micrometres(truth)) = truth {
        let line = DashedLineSeries::new([(truth, -0.03), (truth, 1.08)], 4, 3, TRUTH.stroke_width(1));
        chart.draw_series(line).map_err(plain)?;
    }
    let points = z.iter().zip(&row.phi).map(|(z, &phi)| (z.0, scaled(phi)));
    chart.draw_series(LineSeries::new(points, CURVE.stroke_width(2))).map_err(plain)?;
    if let Some(shape) = &row.shape {
        chart.draw_series([Circle::new((shape.peak_um, 1.0), 4, PEAK.filled())]).map_err(plain)?;
    }
    Ok(())
}

fn legend(cell: &DrawingArea<SVGBackend<'_>, Shift>, truth: bool) -> Result<(), Failure> {
    let style = (FONT, 13).into_font().color(&INK);
    let write = |text: &str, y: i32| cell.draw(&Text::new(text.to_owned(), (90, y - 7), style.clone())).map_err(plain);
    cell.draw(&PathElement::new([(50, 60), (80, 60)], CURVE.stroke_width(2))).map_err(plain)?;
    write("focus value over z", 60)?;
    cell.draw(&Circle::new((65, 85), 4, PEAK.filled())).map_err(plain)?;
    write("largest value", 85)?;
    if truth {
        for x in [50, 57, 64, 71] {
            cell.draw(&PathElement::new([(x, 110), (x + 4, 110)], TRUTH.stroke_width(1))).map_err(plain)?;
        }
        write("known focus", 110)?;
    }
    Ok(())
}
