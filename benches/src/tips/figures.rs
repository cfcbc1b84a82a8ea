//! What came of the scenes, and the figures that sum it up.

use super::speed::Speed;
use parfocal::tip::Tip;
use parfocal_simulator::scene::{Drawn, Seen};
use serde::Serialize;
use std::fmt;

/// One scene and what was found in it.
#[derive(Serialize)]
pub struct Row {
    pub show: &'static str,
    pub seed: u64,
    pub defocus_um: f64,
    pub specks: usize,
    pub contrast: Option<f64>,
    pub noise: f64,
    pub truth_px: Option<[f64; 2]>,
    pub truth_deg: Option<f64>,
    pub tip: Option<Tip>,
    pub error_px: Option<f64>,
    pub detect_ms: f64,
}

impl Row {
    pub fn new(drawn: &Drawn, show: &'static str, seed: u64, tip: Option<Tip>, detect_ms: f64) -> Self {
        let seen = drawn.seen.first();
        let error = |s: &Seen| tip.map(|t| (t.x_px - s.tip_px[0]).hypot(t.y_px - s.tip_px[1]));
        Self {
            show,
            seed,
            defocus_um: drawn.view.focus_um,
            specks: drawn.scene.specks.len(),
            contrast: drawn.scene.pipettes.first().map(|p| p.contrast),
            noise: drawn.exposure.shot_noise / 0.95_f64.sqrt(),
            truth_px: seen.map(|s| s.tip_px),
            truth_deg: seen.map(|s| s.angle_deg),
            tip,
            error_px: seen.and_then(error),
            detect_ms,
        }
    }
}

/// The errors of the scenes within some distance of focus.
#[derive(Serialize)]
struct Summary {
    name: String,
    scenes: usize,
    found: usize,
    median_px: f64,
    p95_px: f64,
    /// Found within 3 px, of all scenes.
    within_3_px: usize,
    /// Found, but farther than [`WRONG_PX`] away.
    wrong: usize,
}

/// All scenes.
#[derive(Serialize)]
pub struct Report {
    summaries: Vec<Summary>,
    empty_scenes: usize,
    false_tips: usize,
    empty_bursts: usize,
    false_tips_of_bursts: usize,
    detect_ms_median: f64,
    speed: Option<Speed>,
    rows: Vec<Row>,
}

/// A found tip farther than this from the true one is another thing.
const WRONG_PX: f64 = 20.0;

impl Report {
    pub fn new(rows: Vec<Row>, speed: Option<Speed>) -> Self {
        let mut summaries = Vec::new();
        for show in ["tip", "burst"] {
            for limit in [3.0, 10.0] {
                let of: Vec<&Row> = rows.iter().filter(|r| r.show == show && r.defocus_um.abs() <= limit).collect();
                if !of.is_empty() {
                    let kind = if show == "tip" { "still" } else { "motion" };
                    summaries.push(summary(format!("{kind}, ±{limit} µm"), &of));
                }
            }
        }
        let empty = |r: &&Row| r.show == "nothing" || r.show == "shank";
        let empty_burst = |r: &&Row| r.show.starts_with("burst of");
        let mut times: Vec<f64> = rows.iter().filter(|r| !r.show.starts_with("burst")).map(|r| r.detect_ms).collect();
        times.sort_by(f64::total_cmp);
        Self {
            summaries,
            empty_scenes: rows.iter().filter(empty).count(),
            false_tips: rows.iter().filter(empty).filter(|r| r.tip.is_some()).count(),
            empty_bursts: rows.iter().filter(empty_burst).count(),
            false_tips_of_bursts: rows.iter().filter(empty_burst).filter(|r| r.tip.is_some()).count(),
            detect_ms_median: times.get(times.len() / 2).copied().unwrap_or_default(),
            speed,
            rows,
        }
    }

    /// Tips of vibrating pipettes that were not found, or not within 3 px.
    fn missed_bursts(&self) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(|r| r.show == "burst" && r.error_px.is_none_or(|error| error > 3.0))
    }

    /// The `count` worst of each kind: tips in the wrong place, false ones, and those that were not found nearest to focus.
    pub fn worst(&self, count: usize) -> Vec<&Row> {
        let mut worst = Vec::new();
        for show in ["tip", "burst"] {
            let mut off: Vec<&Row> = self.rows.iter().filter(|r| r.show == show && r.error_px.is_some()).collect();
            off.sort_by(|a, b| b.error_px.unwrap_or(0.0).total_cmp(&a.error_px.unwrap_or(0.0)));
            worst.extend(off.into_iter().take(count));
            let mut missed: Vec<&Row> = self.rows.iter().filter(|r| r.show == show && r.tip.is_none()).collect();
            missed.sort_by(|a, b| a.defocus_um.abs().total_cmp(&b.defocus_um.abs()));
            worst.extend(missed.into_iter().take(count));
        }
        let empty = |r: &&Row| r.truth_px.is_none() || r.show.ends_with("shank");
        worst.extend(self.rows.iter().filter(empty).filter(|r| r.tip.is_some()));
        worst
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "scenes           number   found   median px   p95 px   within 3 px   > {WRONG_PX} px off")?;
        for s in &self.summaries {
            let percent = |n: usize| 100.0 * n as f64 / s.scenes.max(1) as f64;
            writeln!(
                f,
                "{:<15} {:7} {:6.1}% {:11.2} {:8.2} {:12.1}% {:13}",
                s.name,
                s.scenes,
                percent(s.found),
                s.median_px,
                s.p95_px,
                percent(s.within_3_px),
                s.wrong
            )?;
        }
        for row in self.missed_bursts() {
            let error = row.error_px.map_or("not found".into(), |error| format!("{error:.1} px off"));
            let (contrast, noise) = (100.0 * row.contrast.unwrap_or_default(), 100.0 * row.noise);
            writeln!(
                f,
                "by motion, scene {}: {error} ({:+.1} µm of defocus, contrast {contrast:.1} %, noise {noise:.1} %)",
                row.seed, row.defocus_um
            )?;
        }
        if self.empty_scenes > 0 {
            writeln!(f, "false tips in {} scenes without one: {}", self.empty_scenes, self.false_tips)?;
        }
        if self.empty_bursts > 0 {
            writeln!(f, "false tips in {} bursts without one: {}", self.empty_bursts, self.false_tips_of_bursts)?;
        }
        writeln!(f, "a detection takes {:.1} ms (median)", self.detect_ms_median)?;
        self.speed.iter().try_for_each(|speed| speed.fmt(f))
    }
}

fn summary(name: String, scenes: &[&Row]) -> Summary {
    let mut errors: Vec<f64> = scenes.iter().filter_map(|r| r.error_px).collect();
    errors.sort_by(f64::total_cmp);
    let at = |share: f64| errors.get(((errors.len() as f64 - 1.0) * share).round() as usize).copied();
    Summary {
        name,
        scenes: scenes.len(),
        found: errors.len(),
        median_px: at(0.5).unwrap_or(f64::NAN),
        p95_px: at(0.95).unwrap_or(f64::NAN),
        within_3_px: errors.iter().filter(|e| **e <= 3.0).count(),
        wrong: errors.iter().filter(|e| **e > WRONG_PX).count(),
    }
}
