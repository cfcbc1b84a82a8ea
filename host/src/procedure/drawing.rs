//! Moves as pictures (SVG): where a procedure is going to put its point, and the ways of tips past obstacles.

use super::point::Window;
use crate::calibration::chain::Pixel;
use crate::calibration::frames::{Point, Ref};
use crate::rig::Obstacle;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// A place that a procedure is going to put its point at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Planned {
    /// In the picture.
    pub pixel: Pixel,
    /// Above where it is in focus now, µm.
    pub above_um: f64,
}

/// A way in ref.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// Whose.
    pub name: String,
    /// From point to point in straight lines.
    pub points: Vec<Point<Ref>>,
}

const BLUE: RGBColor = RGBColor(31, 98, 168);
const RED: RGBColor = RGBColor(200, 45, 40);
const GREY: RGBColor = RGBColor(140, 140, 140);
const COLOURS: [RGBColor; 4] = [BLUE, RGBColor(40, 140, 60), RGBColor(160, 80, 170), RGBColor(200, 130, 20)];

type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;

/// Drawing into memory cannot fail; a picture that is not complete is no reason to stop.
fn svg(size: (u32, u32), draw: impl FnOnce(&DrawingArea<SVGBackend<'_>, Shift>) -> Drawn) -> String {
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        let _ = root.fill(&WHITE);
        if let Err(error) = draw(&root) {
            tracing::warn!("the picture of the moves is not complete: {error}");
        }
        let _ = root.present();
    }
    text
}

/// The places in the picture, numbered in their order and joined; their heights as numbers beside them.
pub fn places(planned: &[Planned], window: &Window) -> String {
    let [from, to] = [window.at_share(0.0, 0.0, 0.0), window.at_share(1.0, 1.0, 0.0)];
    let deep = planned.iter().any(|p| p.above_um != 0.0);
    svg((900, 720), |root| {
        let caption = if deep { "Where the point is put (µm above its height now)" } else { "Where the point is put" };
        let mut chart = ChartBuilder::on(root)
            .caption(caption, ("sans-serif", 22))
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(64)
            .build_cartesian_2d(from.x_px..to.x_px, to.y_px..from.y_px)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(232, 232, 232))
            .x_desc("x, px")
            .y_desc("y, px")
            .label_style(("sans-serif", 14))
            .draw()?;
        let at = |p: &Planned| (p.pixel.x_px, p.pixel.y_px);
        chart.draw_series(LineSeries::new(planned.iter().map(at), GREY.stroke_width(1)))?;
        for (i, place) in planned.iter().enumerate() {
            chart.draw_series([Circle::new(at(place), 5, BLUE.filled())])?;
            let height = if deep { format!(" ({:+.0})", place.above_um) } else { String::new() };
            let style = ("sans-serif", 14).into_font().color(&BLACK);
            let label = Text::new(format!("{}{height}", i + 1), (8, -16), style);
            chart.draw_series([EmptyElement::at(at(place)) + label])?;
        }
        Ok(())
    })
}

/// Ways in ref from above and from the side, with the obstacles that have an outline there.
pub fn moves(title: &str, paths: &[Path], obstacles: &[Obstacle]) -> String {
    svg((1100, 560), |root| {
        let root = root.titled(title, ("sans-serif", 20))?;
        let panels = root.split_evenly((1, 2));
        panel(&panels[0], paths, obstacles, [0, 1])?;
        panel(&panels[1], paths, obstacles, [0, 2])
    })
}

fn panel(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    paths: &[Path],
    obstacles: &[Obstacle],
    [across, up]: [usize; 2],
) -> Drawn {
    let place = |p: &Point<Ref>| (p.coordinates[across], p.coordinates[up]);
    let all = || paths.iter().flat_map(|path| path.points.iter().map(place));
    let span = |v: Vec<f64>| {
        let (low, high) = v.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
        (0.5 * (low + high), 0.5 * (high - low))
    };
    let ((cx, hx), (cy, hy)) = (span(all().map(|p| p.0).collect()), span(all().map(|p| p.1).collect()));
    // One scale both ways, so that directions are true.
    let half = (1.2 * hx.max(hy)).max(10.0);
    let ((left, right), (low, high)) = ((cx - half, cx + half), (cy - half, cy + half));
    let names = ["x", "y", "z"];
    let mut chart = ChartBuilder::on(area)
        .margin(10)
        .x_label_area_size(44)
        .y_label_area_size(60)
        .build_cartesian_2d(left..right, low..high)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(232, 232, 232))
        .x_desc(format!("{} of ref, µm", names[across]))
        .y_desc(format!("{} of ref, µm", names[up]))
        .label_style(("sans-serif", 13))
        .draw()?;
    for obstacle in obstacles {
        let corners = match obstacle {
            Obstacle::Box { min_um, max_um, .. } => [(min_um[across], min_um[up]), (max_um[across], max_um[up])],
            Obstacle::Floor { z_um, .. } if up == 2 => [(left, low.min(*z_um)), (right, *z_um)],
            _ => continue,
        };
        let inside = corners.map(|(x, y)| (x.clamp(left, right), y.clamp(low, high)));
        chart.draw_series([Rectangle::new(inside, RED.mix(0.2).filled())])?;
    }
    for (i, path) in paths.iter().enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        chart.draw_series(LineSeries::new(path.points.iter().map(place), colour.stroke_width(2)))?;
        if let Some(end) = path.points.last().map(place) {
            chart.draw_series([Circle::new(end, 5, colour.filled())])?;
            let style = TextStyle::from(("sans-serif", 14).into_font()).color(&colour);
            // Towards the middle, so that it is not cut off at the edge.
            let style = match end.0 > cx {
                true => style.pos(Pos::new(HPos::Right, VPos::Top)),
                false => style.pos(Pos::new(HPos::Left, VPos::Top)),
            };
            // Above and below in turn: ends may lie beside each other.
            let height = if i % 2 == 0 { -18 } else { 6 };
            let aside = if end.0 > cx { -8 } else { 8 };
            chart.draw_series([EmptyElement::at(end) + Text::new(path.name.clone(), (aside, height), style)])?;
        }
    }
    Ok(())
}
