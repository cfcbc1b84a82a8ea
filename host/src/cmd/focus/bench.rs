//! `parfocal focus bench`: the time of every measure on this machine.

use super::super::Output;
use clap::Args;
use parfocal::focus::{Measure, measure};
use parfocal::frames::image_file;
use parfocal::picture::{Picture, View};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::Serialize;
use std::hint::black_box;
use std::path::PathBuf;
use std::time::Instant;

/// Camera formats: VGA, full HD, 5 megapixels.
const SIZES: [(usize, usize); 3] = [(640, 480), (1920, 1080), (2448, 2048)];

#[derive(Debug, Args)]
pub struct Bench {
    /// Time this picture [default: made-up ones of 640x480, 1920x1080 and 2448x2048 at 8 and 16 bits]
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Only this measure [default: all]
    #[arg(long, value_name = "NAME")]
    measure: Option<Measure>,
    /// Runs of which the median is printed
    #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
}

#[derive(Serialize)]
struct Timing {
    measure: Measure,
    width: usize,
    height: usize,
    bits: u32,
    threads: u32,
    /// Median of the runs; the picture is in the cache.
    ms: f64,
}

impl Bench {
    pub fn run(self, out: Output) -> anyhow::Result<()> {
        let pictures = match &self.picture {
            Some(file) => vec![image_file::read(file)?.0],
            None => SIZES
                .into_iter()
                .flat_map(|(w, h)| [made_up(w, h, false), made_up(w, h, true)])
                .collect::<Result<_, _>>()?,
        };
        let mut results = Vec::new();
        for picture in &pictures {
            for m in Measure::ALL.into_iter().filter(|m| self.measure.is_none_or(|only| only == *m)) {
                results.push(self.time(picture.view(), m)?);
            }
        }
        let text: String = results
            .iter()
            .map(|t| format!("{:<24}{:>6}x{:<6}{:>3} bits{:>10.3} ms\n", t.measure, t.width, t.height, t.bits, t.ms))
            .collect();
        out.result(&text, &serde_json::json!({ "results": results }))
    }

    fn time(&self, view: View<'_>, m: Measure) -> anyhow::Result<Timing> {
        // Once for the cache.
        black_box(measure(view, m)?);
        let mut times = Vec::new();
        for _ in 0..self.runs {
            let start = Instant::now();
            black_box(measure(black_box(view), m)?);
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        times.sort_by(f64::total_cmp);
        let ms = times[times.len() / 2];
        Ok(Timing { measure: m, width: view.width(), height: view.height(), bits: view.bits(), threads: 1, ms })
    }
}

/// Waves of two lengths with noise: every measure has something to do, and the histogram is as full as a real one.
fn made_up(width: usize, height: usize, wide: bool) -> anyhow::Result<Picture> {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let waves = (0..width * height).map(|i| {
        let (x, y) = ((i % width) as f64, (i / width) as f64);
        120.0 + 60.0 * (x / 37.0).sin() + 50.0 * (y / 23.0).cos() + 9.0 * random.random::<f64>()
    });
    Ok(if wide {
        Picture::grey16(width, height, waves.map(|v| (256.0 * v) as u16).collect())?
    } else {
        Picture::grey8(width, height, waves.map(|v| v as u8).collect())?
    })
}
