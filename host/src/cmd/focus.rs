//! `parfocal focus`: measures pictures, compares measures over a stack, times them.

mod bench;
mod compare;
mod plot;

use super::Output;
use anyhow::Context;
use clap::{Args, Subcommand};
use parfocal::focus::{Measure, measure};
use parfocal::frames::image_file;
use parfocal::picture::Roi;
use serde::Serialize;
use std::path::PathBuf;

/// Measure the sharpness of pictures; compare and time the measures
#[derive(Debug, Args)]
pub struct Focus {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Print the focus value of pictures (PNG, TIFF, JPEG; every page of a TIFF)
    Measure(MeasureFiles),
    /// Run all measures over a focal stack and recommend one
    Compare(compare::Compare),
    /// Time all measures on this machine, one thread
    Bench(bench::Bench),
}

#[derive(Debug, Args)]
struct MeasureFiles {
    /// Pictures
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Region in pixels, as x,y,width,height [default: the whole picture]
    #[arg(long, value_name = "X,Y,W,H")]
    roi: Option<Roi>,
    /// Focus measure; `parfocal focus compare` finds the best for a kind of picture
    #[arg(long, default_value_t, value_name = "NAME")]
    measure: Measure,
}

/// # Errors
/// What stopped it, with the file's name.
pub fn run(focus: Focus, out: Output) -> anyhow::Result<()> {
    match focus.action {
        Action::Measure(files) => files.run(out),
        Action::Compare(compare) => compare.run(out),
        Action::Bench(bench) => bench.run(out),
    }
}

/// One picture's value.
#[derive(Serialize)]
struct Value {
    file: PathBuf,
    /// The TIFF's page, from 0, if there are several.
    #[serde(skip_serializing_if = "Option::is_none")]
    page: Option<usize>,
    measure: Measure,
    phi: f64,
    width: usize,
    height: usize,
    bits: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    note: Option<String>,
}

impl MeasureFiles {
    fn run(self, out: Output) -> anyhow::Result<()> {
        let mut results = Vec::new();
        for file in &self.files {
            let (pages, note) = image_file::read_pages(file)?;
            if let Some(note) = note {
                eprintln!("{}: {note}", file.display());
            }
            for (k, picture) in pages.iter().enumerate() {
                let page = (pages.len() > 1).then_some(k);
                let place = || match page {
                    Some(k) => format!("{} page {k}", file.display()),
                    None => file.display().to_string(),
                };
                let whole = picture.view();
                let view = self.roi.map_or(Ok(whole), |roi| whole.crop(roi)).with_context(place)?;
                results.push(Value {
                    file: file.clone(),
                    page,
                    measure: self.measure,
                    phi: measure(view, self.measure).with_context(place)?.0,
                    width: view.width(),
                    height: view.height(),
                    bits: view.bits(),
                    note: note.map(|n| n.to_string()),
                });
            }
        }
        let line = |v: &Value| {
            let page = v.page.map_or(String::new(), |k| format!(" page {k}"));
            format!("{:>16.6}  {}{page}\n", v.phi, v.file.display())
        };
        let text = format!("{:>16}\n", self.measure) + &results.iter().map(line).collect::<String>();
        out.result(&text, &serde_json::json!({ "results": results }))
    }
}
