//! `cargo xtask bench tips`: how well tips are found in random scenes.

mod burst;
mod figures;
mod pictures;
mod speed;
mod stack;

use anyhow::{Context, bail};
use clap::Args;
use figures::{Report, Row};
use parfocal::picture::Picture;
use parfocal::tip::{Expect, Tip, detect};
use parfocal_simulator::scene::{Drawn, Frame, Ranges, Show, Viewpoint};
use speed::Speed;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Renders random scenes and finds the tips in them
#[derive(Debug, Args)]
pub struct Arguments {
    /// Ranges from which scenes are drawn
    #[arg(long, default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/tips.toml"))]
    scenes: PathBuf,
    /// Ranges from which cluttered scenes are drawn, in which the pipette vibrates
    #[arg(long, default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/tips-clutter.toml"))]
    clutter: PathBuf,
    /// Scenes with a tip
    #[arg(long, default_value_t = 2000)]
    tips: u64,
    /// Scenes without a pipette, and as many with a shank whose tip lies outside
    #[arg(long, default_value_t = 250)]
    empty: u64,
    /// Cluttered scenes with a vibrating pipette
    #[arg(long, default_value_t = 300)]
    bursts: u64,
    /// Large pictures (1920x1080) in which the time of a detection is measured, on one thread
    #[arg(long, default_value_t = 12)]
    speed: u64,
    /// Cluttered scenes without a pipette, and as many with one that vibrates and whose tip lies outside
    #[arg(long, default_value_t = 50)]
    empty_bursts: u64,
    /// Number of the first scene
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Threads that share the scenes; 1 for a fair time of a detection
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=64))]
    threads: u64,
    /// Where to write every scene's result (JSON)
    #[arg(long)]
    out: Option<PathBuf>,
    /// Draw the worst scenes of each kind into this folder
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Only compare the renderer with the real focal stack in this folder, and draw both into `--drawn`
    #[arg(long, value_name = "DIR", requires = "drawn")]
    stack: Option<PathBuf>,
    /// The picture of that comparison
    #[arg(long, value_name = "FILE", requires = "stack")]
    drawn: Option<PathBuf>,
    /// How many of each kind
    #[arg(long, default_value_t = 12)]
    worst: usize,
}

/// Finds tips and prints how well.
///
/// # Errors
/// Ranges that cannot be read, results that cannot be written.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if let (Some(stack), Some(drawn)) = (&arguments.stack, &arguments.drawn) {
        return stack::compare(stack, drawn);
    }
    let (ranges, clutter) = (ranges(&arguments.scenes)?, ranges(&arguments.clutter)?);
    let mut jobs: Vec<(Show, &'static str, u64)> = Vec::new();
    for (show, name, count) in [
        (Show::Tip, "tip", arguments.tips),
        (Show::Nothing, "nothing", arguments.empty),
        (Show::ShankOnly, "shank", arguments.empty),
        (Show::Tip, "burst", arguments.bursts),
        (Show::Nothing, "burst of nothing", arguments.empty_bursts),
        (Show::ShankOnly, "burst of a shank", arguments.empty_bursts),
    ] {
        jobs.extend((arguments.seed..arguments.seed + count).map(|seed| (show, name, seed)));
    }
    let drawn = |show, name: &str, seed| {
        if name.starts_with("burst") { clutter.draw(show, seed) } else { ranges.draw(show, seed) }
    };
    let rows = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..arguments.threads as usize)
            .map(|worker| {
                let (jobs, drawn) = (&jobs, &drawn);
                scope.spawn(move || {
                    let mine = jobs.iter().skip(worker).step_by(arguments.threads as usize);
                    mine.map(|&(show, name, seed)| row(&drawn(show, name, seed), name, seed)).collect::<Vec<_>>()
                })
            })
            .collect();
        workers
            .into_iter()
            .flat_map(|w| w.join().expect("a worker panics only with the program"))
            .collect::<Result<Vec<Row>, _>>()
    })?;
    let report = Report::new(rows, Speed::measure(&ranges, arguments.speed, arguments.seed)?);
    print!("{report}");
    if let Some(out) = &arguments.out {
        std::fs::write(out, serde_json::to_string(&report)?).with_context(|| out.display().to_string())?;
    }
    if let Some(folder) = &arguments.pictures {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        for row in report.worst(arguments.worst) {
            let show = jobs.iter().find(|j| j.1 == row.show).map_or(Show::Tip, |j| j.0);
            let frame = picture_of(&drawn(show, row.show, row.seed))?;
            pictures::save(folder, row, &frame)?;
        }
    }
    Ok(())
}

fn ranges(path: &Path) -> anyhow::Result<Ranges> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    match toml::from_str(&text) {
        Ok(ranges) => Ok(ranges),
        Err(error) => bail!("{}: {error}", path.display()),
    }
}

/// Finds the tip of one scene.
fn row(drawn: &Drawn, show: &'static str, seed: u64) -> anyhow::Result<Row> {
    let (tip, detect_ms): (Option<Tip>, f64) = if show.starts_with("burst") {
        burst::detect(drawn)?
    } else {
        let picture = picture_of(drawn)?;
        let start = Instant::now();
        let tip = detect(&picture.view(), &Expect::default());
        (tip, start.elapsed().as_secs_f64() * 1e3)
    };
    Ok(Row::new(drawn, show, seed, tip, detect_ms))
}

/// The scene as the camera shows it.
fn picture_of(drawn: &Drawn) -> anyhow::Result<Picture> {
    picture(&drawn.view, drawn.scene.render(&drawn.view, &drawn.exposure))
}

fn picture(view: &Viewpoint, frame: Frame) -> anyhow::Result<Picture> {
    Ok(if view.bits <= 8 {
        Picture::grey8(frame.width, frame.height, frame.pixels.iter().map(|v| *v as u8).collect())?
    } else {
        Picture::grey16(frame.width, frame.height, frame.pixels)?
    })
}
