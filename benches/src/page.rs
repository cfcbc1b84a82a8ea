//! `cargo xtask bench page`: what pictures for the operator page cost a scan that runs meanwhile.
//!
//! `parfocal serve` shows 1280x960 frames of a rendered stack at 50 frames/s. Scans run without a page, then with one that draws
//! every picture it is sent; each sample's time from its frame's arrival to its value's leaving for the board is told by
//! `GET /api/curve`. Every round is one scan of either kind, now the one first, now the other, so that what else the computer does
//! meets both alike. How well the growth is known is told by drawing the rounds again with replacement (Efron 1979).

use anyhow::{Context, bail};
use clap::Args;
use image::{GrayImage, Luma};
use parfocal_simulator::scene::{Exposure, Light, Pipette, Scene, Viewpoint};
use parfocal_tests::page::Served;
use rand::{RngExt, SeedableRng};
use serde_json::json;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;
use tungstenite::Message;

/// Streams pictures to a page while scans run
#[derive(Debug, Args)]
pub struct Arguments {
    /// Scans without and with a page, each
    #[arg(long, default_value_t = 12)]
    rounds: usize,
    /// One JSON object on stdout
    #[arg(long)]
    json: bool,
}

/// Frames of the stack: their size and distance.
const SIZE: (usize, usize) = (1280, 960);
const PLANES: usize = 61;
const STEP_UM: f64 = 0.5;

/// Runs the bench.
///
/// # Errors
/// When the program does not start or a scan fails.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    stack(folder.path())?;
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/release/parfocal");
    let camera = format!("stack:{}", folder.path().display());
    let mut served = Served::start_program(Command::new(program), &["--camera", &camera]);
    served.take();
    served.post("/api/look", &json!({ "region": { "x": 560, "y": 400, "width": 160, "height": 160 } }));
    let (mut rounds, mut rates) = (Vec::new(), Vec::new());
    for k in 0..arguments.rounds.max(1) {
        let mut round = Round::default();
        for watching in if k % 2 == 0 { [false, true] } else { [true, false] } {
            if !watching {
                round.alone = scan(&served)?;
                continue;
            }
            let page = Watching::open(&served)?;
            let (began, before) = (Instant::now(), page.pictures());
            round.watched = scan(&served)?;
            rates.push((page.pictures() - before) as f64 / began.elapsed().as_secs_f64());
        }
        let (a, w) = (Quantiles::of(&round.alone)?, Quantiles::of(&round.watched)?);
        let of = arguments.rounds;
        eprintln!("round {:2} of {of}: p99 {:.2} ms without, {:.2} ms with a page", k + 1, a.p99, w.p99);
        rounds.push(round);
    }
    let rate = rates.iter().sum::<f64>() / rates.len() as f64;
    let all =
        |of: fn(&Round) -> &Vec<u64>| rounds.iter().flat_map(|round| of(round).iter().copied()).collect::<Vec<_>>();
    let (a, w) = (Quantiles::of(&all(|r| &r.alone))?, Quantiles::of(&all(|r| &r.watched))?);
    let (low, high) = growth_within(&rounds)?;
    eprintln!("                 samples   p50 ms   p90 ms   p99 ms   max ms");
    for (name, q) in [("without a page", &a), ("with a page", &w)] {
        eprintln!("{name:<15} {:9} {:8.2} {:8.2} {:8.2} {:8.2}", q.samples, q.p50, q.p90, q.p99, q.max);
    }
    eprintln!(
        "the p99 grows by {:.2} ms (95 % of {REDRAWN} redrawn sets of rounds: {low:.2} to {high:.2} ms); the page got {rate:.1} pictures of {}x{} a second",
        w.p99 - a.p99,
        SIZE.0,
        SIZE.1
    );
    if arguments.json {
        println!(
            "{}",
            json!({
                "samples": [a.samples, w.samples], "p50_ms": [a.p50, w.p50], "p99_alone_ms": a.p99, "p99_watched_ms": w.p99,
                "growth_ms": w.p99 - a.p99, "growth_95_ms": [low, high], "pictures_per_s": rate,
            })
        );
    }
    Ok(())
}

/// Sets of rounds that are drawn anew.
const REDRAWN: usize = 2000;

/// One scan of either kind: latencies, µs.
#[derive(Default)]
struct Round {
    alone: Vec<u64>,
    watched: Vec<u64>,
}

/// Between what the growth of the p99 lies in 95 % of sets of rounds drawn with replacement, ms.
fn growth_within(rounds: &[Round]) -> anyhow::Result<(f64, f64)> {
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(1);
    let mut growths = Vec::with_capacity(REDRAWN);
    for _ in 0..REDRAWN {
        let drawn: Vec<&Round> = (0..rounds.len()).map(|_| &rounds[random.random_range(0..rounds.len())]).collect();
        let p99 = |of: fn(&Round) -> &Vec<u64>| {
            Quantiles::of(&drawn.iter().flat_map(|round| of(round).iter().copied()).collect::<Vec<_>>()).map(|q| q.p99)
        };
        growths.push(p99(|r| &r.watched)? - p99(|r| &r.alone)?);
    }
    growths.sort_unstable_by(f64::total_cmp);
    Ok((growths[REDRAWN / 40], growths[REDRAWN - 1 - REDRAWN / 40]))
}

struct Quantiles {
    samples: usize,
    p50: f64,
    p90: f64,
    p99: f64,
    max: f64,
}

impl Quantiles {
    fn of(us: &[u64]) -> anyhow::Result<Self> {
        let mut us = us.to_vec();
        us.sort_unstable();
        let at = |share: f64| us.get(((us.len() as f64 - 1.0) * share).round() as usize).map(|v| *v as f64 / 1000.0);
        let none = || anyhow::anyhow!("no sample came");
        Ok(Self {
            samples: us.len(),
            p50: at(0.5).with_context(none)?,
            p90: at(0.9).with_context(none)?,
            p99: at(0.99).with_context(none)?,
            max: at(1.0).with_context(none)?,
        })
    }
}

/// Scans the whole range and gives each sample's latency, µs.
fn scan(served: &Served) -> anyhow::Result<Vec<u64>> {
    let answer = served.post("/api/autofocus", &json!({ "strategy": "scan", "sample_step_um": 0.1, "wait": true }));
    if answer.status != 200 {
        bail!("the scan failed: {}", answer.json());
    }
    let curve = served.get("/api/curve").json();
    let latencies = curve["latency_us"].as_array().context("the curve has no latencies")?;
    Ok(latencies.iter().filter_map(serde_json::Value::as_u64).collect())
}

/// A page that draws whatever it is sent.
struct Watching {
    pictures: Arc<AtomicU64>,
    ending: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Watching {
    fn open(served: &Served) -> anyhow::Result<Self> {
        let (mut socket, _) = tungstenite::connect(format!("ws://{}/api/live", served.address))?;
        let (pictures, ending) = (Arc::<AtomicU64>::default(), Arc::<AtomicBool>::default());
        let (count, end) = (pictures.clone(), ending.clone());
        let thread = std::thread::spawn(move || {
            while !end.load(Ordering::SeqCst) {
                match socket.read() {
                    Ok(Message::Binary(_)) => {
                        count.fetch_add(1, Ordering::SeqCst);
                        if socket.send(Message::text("{\"type\":\"drawn\"}")).is_err() {
                            return;
                        }
                    }
                    Ok(_) => {}
                    Err(_) => return,
                }
            }
        });
        Ok(Self { pictures, ending, thread: Some(thread) })
    }

    fn pictures(&self) -> u64 {
        self.pictures.load(Ordering::SeqCst)
    }
}

impl Drop for Watching {
    fn drop(&mut self) {
        self.ending.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Writes a stack of a pipette's tip, in focus in the middle plane.
fn stack(folder: &Path) -> anyhow::Result<()> {
    let middle = (PLANES / 2) as f64 * STEP_UM;
    let pipette = Pipette {
        tip_um: [0.0, 0.0, 0.0],
        azimuth_rad: 0.2,
        descent_rad: 0.5,
        opening_radius_um: 1.0,
        half_angle_rad: 0.09,
        contrast: 0.12,
    };
    let scene =
        Scene { light: Light { vignetting: 0.08, slope: [0.02, -0.01] }, pipettes: vec![pipette], ..Scene::default() };
    for plane in 0..PLANES {
        let z = plane as f64 * STEP_UM - middle;
        let view = Viewpoint { bits: 8, ..Viewpoint::level([0.0, 0.0], z, 0.16, SIZE.0, SIZE.1) };
        let exposure = Exposure { level: 0.5, shot_noise: 0.01, read_noise: 0.002, seed: plane as u64 };
        let frame = scene.render(&view, &exposure);
        let picture = GrayImage::from_fn(SIZE.0 as u32, SIZE.1 as u32, |x, y| {
            Luma([frame.pixels[y as usize * SIZE.0 + x as usize] as u8])
        });
        picture.save(folder.join(format!("{plane:03}.png")))?;
    }
    std::fs::write(folder.join("stack.toml"), format!("z_step_um = {STEP_UM}\nfirst_z_um = {}\n", -middle))?;
    Ok(())
}
