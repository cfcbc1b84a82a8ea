//! `parfocal focus compare`: which measure suits a kind of picture.

use super::super::Output;
use super::plot;
use anyhow::Context;
use clap::Args;
use parfocal::focus::compare::{Recommendation, Row, compare, recommend};
use parfocal::frames::stack::Stack;
use parfocal::picture::Roi;
use parfocal_protocol::units::Micrometres;
use serde::Serialize;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct Compare {
    /// Folder of planes, or multi-page TIFF, with its stack.toml
    stack: PathBuf,
    /// Region in pixels, as x,y,width,height [default: the stack's roi_px, else the whole picture]
    #[arg(long, value_name = "X,Y,W,H")]
    roi: Option<Roi>,
    /// Draw all curves into this SVG file
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Comparison {
    stack: PathBuf,
    roi: Option<Roi>,
    planes: usize,
    first_z_um: f64,
    z_step_um: f64,
    /// The known focus.
    truth_um: Option<f64>,
    results: Vec<Row>,
    recommendation: Recommendation,
}

impl Compare {
    pub fn run(self, out: Output) -> anyhow::Result<()> {
        let stack = Stack::open(&self.stack)?;
        if let Some(note) = stack.note {
            eprintln!("{}: {note}", self.stack.display());
        }
        let roi = self.roi.or(stack.roi());
        let place = || self.stack.display().to_string();
        let planes: Vec<_> = stack
            .planes
            .iter()
            .map(|p| roi.map_or(Ok(p.view()), |roi| p.view().crop(roi)))
            .collect::<Result<_, _>>()
            .with_context(place)?;
        let z: Vec<_> = (0..planes.len()).map(|k| stack.z(k)).collect();
        let truth = stack.about.truth.as_ref().and_then(|t| t.plane).map(|plane| stack.z(plane));

        let rows = compare(&planes, &z, truth).with_context(place)?;
        let recommendation = recommend(&rows, Micrometres(stack.about.z_step_um), truth);
        if let Some(file) = &self.plot {
            plot::curves(file, &rows, &z, truth).with_context(|| format!("{}: cannot be written", file.display()))?;
        }
        let text = format!("{}\n{}\n", table(&rows), recommendation.words);
        let comparison = Comparison {
            stack: self.stack,
            roi,
            planes: planes.len(),
            first_z_um: stack.about.first_z_um,
            z_step_um: stack.about.z_step_um,
            truth_um: truth.map(|t| t.0),
            results: rows,
            recommendation,
        };
        out.result(&text, &comparison)
    }
}

fn table(rows: &[Row]) -> String {
    let mut text = format!(
        "{:<24}{:>9}{:>9}{:>8}{:>10}{:>9}{:>17}{:>8}{:>9}\n{:<24}{:>9}{:>9}{:>8}{:>10}{:>9}{:>17}{:>8}{:>9}\n",
        "measure",
        "peak",
        "error",
        "other",
        "farthest",
        "width",
        "climbs from..to",
        "noise",
        "time",
        "",
        "µm",
        "µm",
        "maxima",
        "µm",
        "µm",
        "µm",
        "%",
        "µs",
    );
    let number = |value: Option<f64>, digits: usize| value.map_or("-".into(), |v| format!("{v:.digits$}"));
    for row in rows {
        let Some(shape) = &row.shape else {
            text += &format!("{:<24}  flat\n", row.measure);
            continue;
        };
        let edge = if shape.at_edge { "!" } else { "" };
        text += &format!(
            "{:<24}{:>9}{:>9}{:>8}{:>10}{:>9}{:>17}{:>8}{:>9.1}\n",
            row.measure,
            format!("{edge}{:.2}", shape.peak_um),
            number(row.error_um, 2),
            shape.other_maxima,
            number(shape.farthest_maximum_um, 2),
            number(shape.width_um, 2),
            format!("{:.1}..{:.1}", shape.climb_um[0], shape.climb_um[1]),
            number(shape.noise.map(|n| 100.0 * n), 2),
            1e3 * row.ms,
        );
    }
    if rows.iter().any(|r| r.shape.as_ref().is_some_and(|s| s.at_edge)) {
        text += "! the peak is at the edge of the stack\n";
    }
    text
}
