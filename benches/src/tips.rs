//! `cargo xtask bench tips`: how well tips are found in random scenes.

use anyhow::{Context, bail};
use clap::Args;
use parfocal::picture::Picture;
use parfocal::tip::{Expect, Tip, detect};
use parfocal_simulator::scene::{Drawn, Ranges, Show};
use serde::Serialize;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Renders random scenes and finds the tips in them
#[derive(Debug, Args)]
pub struct Arguments {
    /// Ranges from which scenes are drawn
    #[arg(long, default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/tips.toml"))]
    scenes: PathBuf,
    /// Scenes with a tip
    #[arg(long, default_value_t = 2000)]
    tips: u64,
    /// Scenes without a pipette, and as many with a shank whose tip lies outside
    #[arg(long, default_value_t = 250)]
    empty: u64,
    /// Number of the first scene
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Where to write the result
    #[arg(long)]
    out: Option<PathBuf>,
}

/// One scene and what was found in it.
#[derive(Serialize)]
struct Row {
    show: &'static str,
    seed: u64,
    defocus_um: f64,
    specks: usize,
    contrast: Option<f64>,
    truth_px: Option<[f64; 2]>,
    truth_deg: Option<f64>,
    tip: Option<Tip>,
    error_px: Option<f64>,
    detect_ms: f64,
}

/// The errors of the scenes within some distance of focus.
#[derive(Serialize)]
struct Summary {
    defocus_um: f64,
    scenes: usize,
    found: usize,
    median_px: f64,
    p95_px: f64,
    wrong: usize,
}

#[derive(Serialize)]
struct Report {
    summaries: Vec<Summary>,
    empty_scenes: usize,
    false_tips: usize,
    detect_ms_median: f64,
    rows: Vec<Row>,
}

/// A found tip farther than this from the true one is another thing.
const WRONG_PX: f64 = 20.0;

impl Arguments {
    /// # Errors
    /// A file of ranges that cannot be read or makes no sense, a result that cannot be written.
    pub fn run(self) -> anyhow::Result<()> {
        let name = self.scenes.display().to_string();
        let text = std::fs::read_to_string(&self.scenes).with_context(|| name.clone())?;
        let ranges: Ranges = toml::from_str(&text).with_context(|| name.clone())?;
        if !(1..=16).contains(&ranges.bits) {
            bail!("{name}: bits = {}: a camera has 1 to 16", ranges.bits);
        }
        let mut rows = Vec::new();
        for (show, name, count) in [
            (Show::Tip, "tip", self.tips),
            (Show::Nothing, "nothing", self.empty),
            (Show::ShankOnly, "shank", self.empty),
        ] {
            for seed in self.seed..self.seed + count {
                rows.push(row(&ranges.draw(show, seed), name, seed)?);
            }
        }
        let summaries = [3.0, 10.0].map(|limit| summary(&rows, limit)).into();
        let empty: Vec<&Row> = rows.iter().filter(|r| r.truth_px.is_none() || r.show == "shank").collect();
        let mut times: Vec<f64> = rows.iter().map(|r| r.detect_ms).collect();
        times.sort_by(f64::total_cmp);
        let report = Report {
            summaries,
            empty_scenes: empty.len(),
            false_tips: empty.iter().filter(|r| r.tip.is_some()).count(),
            detect_ms_median: times.get(times.len() / 2).copied().unwrap_or_default(),
            rows,
        };
        println!("within    scenes   found   wrong   median px   p95 px");
        for s in &report.summaries {
            println!(
                "±{:<4} µm {:8} {:7} {:7} {:11.2} {:8.2}",
                s.defocus_um, s.scenes, s.found, s.wrong, s.median_px, s.p95_px
            );
        }
        println!("false tips in {} scenes without one: {}", report.empty_scenes, report.false_tips);
        println!("a detection takes {:.1} ms (median)", report.detect_ms_median);
        if let Some(out) = &self.out {
            std::fs::write(out, serde_json::to_string(&report)?).with_context(|| out.display().to_string())?;
        }
        Ok(())
    }
}

fn row(drawn: &Drawn, show: &'static str, seed: u64) -> anyhow::Result<Row> {
    let frame = drawn.scene.render(&drawn.view, &drawn.exposure);
    let picture = if drawn.view.bits <= 8 {
        Picture::grey8(frame.width, frame.height, frame.pixels.iter().map(|v| *v as u8).collect())?
    } else {
        Picture::grey16(frame.width, frame.height, frame.pixels)?
    };
    let start = Instant::now();
    let tip = detect(&picture.view(), &Expect::default());
    let took: Duration = start.elapsed();
    let seen = drawn.seen.first();
    let error = |s: &parfocal_simulator::scene::Seen| tip.map(|t| (t.x_px - s.tip_px[0]).hypot(t.y_px - s.tip_px[1]));
    Ok(Row {
        show,
        seed,
        defocus_um: drawn.view.focus_um,
        specks: drawn.scene.specks.len(),
        contrast: drawn.scene.pipettes.first().map(|p| p.contrast),
        truth_px: seen.map(|s| s.tip_px),
        truth_deg: seen.map(|s| s.angle_deg),
        tip,
        error_px: seen.and_then(error),
        detect_ms: took.as_secs_f64() * 1e3,
    })
}

fn summary(rows: &[Row], limit: f64) -> Summary {
    let scenes: Vec<&Row> = rows.iter().filter(|r| r.show == "tip" && r.defocus_um.abs() <= limit).collect();
    let mut errors: Vec<f64> = scenes.iter().filter_map(|r| r.error_px).collect();
    errors.sort_by(f64::total_cmp);
    let at = |share: f64| errors.get(((errors.len() as f64 - 1.0) * share).round() as usize).copied();
    Summary {
        defocus_um: limit,
        scenes: scenes.len(),
        found: errors.len(),
        median_px: at(0.5).unwrap_or(f64::NAN),
        p95_px: at(0.95).unwrap_or(f64::NAN),
        wrong: errors.iter().filter(|e| **e > WRONG_PX).count(),
    }
}
