//! The report's pictures, as SVG.

use crate::calibration::robust::Solution;
use nalgebra::{Matrix3, Vector2, Vector3};
use plotters::prelude::*;

const SIZE: (u32, u32) = (900, 680);
const BLUE: RGBColor = RGBColor(31, 98, 168);
const RED: RGBColor = RGBColor(200, 45, 40);
const GREY: RGBColor = RGBColor(140, 140, 140);
/// x, y and z.
const AXES: [RGBColor; 3] = [RGBColor(200, 45, 40), RGBColor(40, 140, 60), RGBColor(31, 98, 168)];

/// Points with their errors as arrows.
pub struct Vectors<'a> {
    pub title: &'a str,
    pub unit: &'a str,
    pub points: &'a [Vector2<f64>],
    pub errors: &'a [Vector2<f64>],
    pub inliers: &'a [bool],
    /// The picture's size around 0, 0, drawn as a frame.
    pub frame: Option<Vector2<f64>>,
    /// Whether y goes down, as in a picture.
    pub down: bool,
}

type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;

/// Draws into a string; drawing into memory cannot fail, and a picture is no reason to lose a calibration.
fn svg(draw: impl FnOnce(&DrawingArea<SVGBackend<'_>, plotters::coord::Shift>) -> Drawn) -> String {
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        let _ = root.fill(&WHITE);
        if let Err(error) = draw(&root) {
            tracing::warn!("a picture of the report is not complete: {error}");
        }
        let _ = root.present();
    }
    text
}

/// Residual vectors over the places.
pub fn vectors(v: &Vectors<'_>) -> String {
    let half = match v.frame {
        Some(size) => size / 2.0,
        None => v.points.iter().fold(Vector2::repeat(1e-6), |m, p| m.sup(&p.abs())) * 1.15,
    };
    // One scale for both axes, so that directions are true.
    let drawn = Vector2::new(780.0, 560.0);
    let scale = (half.x / drawn.x).max(half.y / drawn.y) * 1.04;
    let (rx, ry) = (scale * drawn.x, scale * drawn.y);
    let largest = v.errors.iter().zip(v.inliers).filter(|(_, used)| **used).map(|(e, _)| e.norm()).fold(0.0, f64::max);
    let gain = if largest > 0.0 { nice(0.12 * 2.0 * rx.min(ry) / largest) } else { 1.0 };
    let caption = format!("{} (arrows {gain} times as long)", v.title);
    let y_range = if v.down { ry..-ry } else { -ry..ry };
    svg(|root| {
        let mut chart = ChartBuilder::on(root)
            .caption(caption, ("sans-serif", 22))
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(64)
            .build_cartesian_2d(-rx..rx, y_range)?;
        let from = if v.frame.is_some() { "the picture's centre" } else { "the samples' mean" };
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(232, 232, 232))
            .x_desc(format!("x from {from}, {}", v.unit))
            .y_desc(format!("y, {}", v.unit))
            .label_style(("sans-serif", 14))
            .draw()?;
        if let Some(size) = v.frame {
            let (w, h) = (size.x / 2.0, size.y / 2.0);
            chart.draw_series([Rectangle::new([(-w, -h), (w, h)], GREY.stroke_width(2))])?;
        }
        for (i, ((p, e), used)) in v.points.iter().zip(v.errors).zip(v.inliers).enumerate() {
            let at = (p.x, p.y);
            if *used {
                let end = p + e * gain;
                chart.draw_series([PathElement::new(vec![at, (end.x, end.y)], BLUE.stroke_width(2))])?;
                chart.draw_series([Circle::new(at, 4, BLUE.filled())])?;
            } else {
                chart.draw_series([Cross::new(at, 7, RED.stroke_width(3))])?;
            }
            let label = (i + 1).to_string();
            let label = EmptyElement::at(at) + Text::new(label, (7, -16), ("sans-serif", 13).into_font().color(&BLACK));
            chart.draw_series([label])?;
        }
        Ok(())
    })
}

/// A round number near `v`: 1, 2 or 5 times a power of ten.
fn nice(v: f64) -> f64 {
    let power = 10f64.powf(v.log10().floor());
    let step = [5.0, 2.0, 1.0].into_iter().find(|s| s * power <= v).unwrap_or(1.0);
    step * power
}

/// One panel an axis: residuals by row, the tolerance dashed. Rejected ones beyond the panel are drawn at its edge.
pub fn residuals<const D: usize>(solution: &Solution<D>) -> String {
    let n = solution.residuals.len();
    let inside = solution.residuals.iter().zip(&solution.inliers).filter(|(_, used)| **used);
    let largest = inside.flat_map(|(r, _)| r.iter().map(|v| v.abs()).collect::<Vec<_>>()).fold(0.0, f64::max);
    let reach = (1.25 * solution.tolerance.max(largest)).max(1e-9);
    svg(|root| {
        let panels =
            root.titled("Residuals by sample, µm (sample minus map)", ("sans-serif", 22))?.split_evenly((D, 1));
        for (axis, panel) in panels.iter().enumerate() {
            let mut chart = ChartBuilder::on(panel)
                .margin(8)
                .x_label_area_size(if axis + 1 == D { 40 } else { 20 })
                .y_label_area_size(64)
                .build_cartesian_2d(0.4..n as f64 + 0.6, -reach..reach)?;
            chart
                .configure_mesh()
                .disable_x_mesh()
                .light_line_style(WHITE)
                .bold_line_style(RGBColor(232, 232, 232))
                .x_labels(n.min(25))
                .x_label_formatter(&|x| format!("{x:.0}"))
                .x_desc(if axis + 1 == D { "row" } else { "" })
                .y_labels(5)
                .y_label_formatter(&|y| tick(*y))
                .y_desc(["x", "y", "z"][axis.min(2)])
                .label_style(("sans-serif", 14))
                .draw()?;
            chart.draw_series([PathElement::new(vec![(0.4, 0.0), (n as f64 + 0.6, 0.0)], GREY)])?;
            for level in [-solution.tolerance, solution.tolerance] {
                let ends = [(0.4, level), (n as f64 + 0.6, level)];
                chart.draw_series(DashedLineSeries::new(ends, 6, 4, GREY.into()))?;
            }
            for (i, (r, used)) in solution.residuals.iter().zip(&solution.inliers).enumerate() {
                let (x, y) = (i as f64 + 1.0, r[axis].clamp(-0.96 * reach, 0.96 * reach));
                if *used {
                    let colour = AXES[axis.min(2)];
                    chart.draw_series([PathElement::new(vec![(x, 0.0), (x, y)], colour.stroke_width(2))])?;
                    chart.draw_series([Circle::new((x, y), 4, colour.filled())])?;
                } else {
                    chart.draw_series([Cross::new((x, y), 6, BLACK.stroke_width(2))])?;
                }
            }
        }
        Ok(())
    })
}

/// The manipulator's axes among ref's, seen from the front right and above.
pub fn axes(linear: &Matrix3<f64>) -> String {
    let angle = |a: usize, b: usize| linear.column(a).angle(&linear.column(b)).to_degrees();
    let title = format!("Axes: {:.1}° xy, {:.1}° yz, {:.1}° zx", angle(0, 1), angle(1, 2), angle(2, 0));
    svg(|root| {
        let mut chart = ChartBuilder::on(root)
            .caption(title, ("sans-serif", 22))
            .margin(12)
            .build_cartesian_2d(-1.7..1.7, -1.27..1.27)?;
        // A box of the floor's grid gives the eye its bearings.
        for k in -2..=2 {
            let t = f64::from(k) / 2.0;
            for (a, b) in [((t, -1.0), (t, 1.0)), ((-1.0, t), (1.0, t))] {
                let ends = [a, b].map(|(x, y)| project(&Vector3::new(x, y, 0.0)));
                chart.draw_series([PathElement::new(ends.to_vec(), RGBColor(225, 225, 225))])?;
            }
        }
        for (k, name) in ["x", "y", "z"].into_iter().enumerate() {
            let of_ref = Vector3::ith(k, 1.15);
            arrow(&mut chart, &of_ref, GREY, 1, &format!("ref {name}"), 0.0)?;
            let column: Vector3<f64> = linear.column(k).into();
            let shown = column / linear.column_iter().map(|c| c.norm()).fold(1e-9, f64::max);
            // The foot on the floor shows how an axis leans.
            let foot = Vector3::new(shown.x, shown.y, 0.0);
            let drop = [project(&shown), project(&foot), project(&Vector3::zeros())];
            chart.draw_series(DashedLineSeries::new(drop, 4, 4, AXES[k].mix(0.5).into()))?;
            // Beside its arrow: beyond its end is where ref's own axis may be.
            arrow(&mut chart, &shown, AXES[k], 4, name, 0.09)?;
        }
        Ok(())
    })
}

/// A number at an axis, without a minus before zero and zeros behind.
fn tick(v: f64) -> String {
    let text = format!("{v:.3}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

type Plane<'a, 'b> = ChartContext<
    'a,
    SVGBackend<'b>,
    Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>,
>;

fn arrow(
    chart: &mut Plane<'_, '_>,
    tip: &Vector3<f64>,
    colour: RGBColor,
    width: u32,
    name: &str,
    beside: f64,
) -> Drawn {
    let (from, to) = (project(&Vector3::zeros()), project(tip));
    chart.draw_series([PathElement::new(vec![from, to], colour.stroke_width(width))])?;
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let length = dx.hypot(dy).max(1e-9);
    let (ux, uy) = (dx / length, dy / length);
    let side = |s: f64| (to.0 - 0.06 * ux - s * 0.025 * uy, to.1 - 0.06 * uy + s * 0.025 * ux);
    chart.draw_series([Polygon::new(vec![to, side(1.0), side(-1.0)], colour.filled())])?;
    let beyond = if beside > 0.0 { -0.03 } else { 0.06 };
    let at = (to.0 + beyond * ux - beside * uy - 0.02, to.1 + beyond * uy + beside * ux + 0.03);
    chart.draw_series([Text::new(name.to_owned(), at, ("sans-serif", 17).into_font().color(&colour))])?;
    Ok(())
}

/// Orthographic, turned by 30° about z and tipped by 25°.
fn project(p: &Vector3<f64>) -> (f64, f64) {
    let ((s, c), (st, ct)) = (30f64.to_radians().sin_cos(), 25f64.to_radians().sin_cos());
    let (x, y) = (c * p.x - s * p.y, s * p.x + c * p.y);
    (x, ct * p.z + st * y)
}
