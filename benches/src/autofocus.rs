//! Scans on generated focus curves: how sure and how short they are.
//!
//! Reads curves (Φ(z) = b + (1+u²)^(−p) + Σ h·exp(−(z−c)²/(2s²)), u = (z−zc)/(wl below zc, wr above), lengths in µm), runs a
//! strategy on each with multiplicative noise, and writes one line a run: way J, frames, final z. Scored are success
//! (|z − zstar| ≤ 1 µm) and dJ = J − |zstar − z0| − J0.

use anyhow::{Context, Result, bail};
use parfocal_firmware::autofocus::curve::Curve;
use parfocal_firmware::autofocus::search::Search;
use parfocal_firmware::autofocus::{Ask, Scan};
use parfocal_protocol::autofocus::{Mode, ScanId, ScanParameters, Strategy, Subject};
use parfocal_protocol::units::{Axis, FocusValue, MicrometresPerSecond, Milliseconds, Nanometres};
use parfocal_simulator::strategies::{self, Brent, CoarseFine, Golden};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Scans on generated focus curves.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// File of curves.
    #[arg(long)]
    curves: PathBuf,
    /// Standard deviations of the values, relative.
    #[arg(long, value_delimiter = ',', default_value = "0,0.001,0.01")]
    noise: Vec<f64>,
    /// Where the scans start.
    #[arg(long, value_delimiter = ',', default_value = "centre,random")]
    z0: Vec<Start>,
    /// How they look for the peak.
    #[arg(long, default_value = "climb")]
    strategy: By,
    /// Where the runs are written, as JSON.
    #[arg(long)]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Start {
    Centre,
    Random,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum By {
    Climb,
    Mixed,
    Scan,
    Golden,
    CoarseFine,
    Brent,
}

#[derive(Debug, Deserialize)]
struct File {
    #[serde(rename = "J0")]
    j0: f64,
    curves: Vec<Generated>,
}

/// A curve of the file, µm.
#[derive(Debug, Deserialize)]
struct Generated {
    id: u64,
    #[serde(rename = "R")]
    r: f64,
    zc: f64,
    wl: f64,
    wr: f64,
    p: f64,
    b: f64,
    bumps: Vec<[f64; 3]>,
    zstar: f64,
    z0random: f64,
}

/// One scan, µm.
#[derive(Debug, Serialize)]
struct Run {
    id: u64,
    noise: f64,
    z0mode: Start,
    #[serde(rename = "J")]
    j: f64,
    frames: u32,
    z: f64,
}

impl Generated {
    fn phi(&self, z: f64) -> f64 {
        let u = (z - self.zc) / if z < self.zc { self.wl } else { self.wr };
        let bumps: f64 = self.bumps.iter().map(|[h, c, s]| h * (-(z - c) * (z - c) / (2.0 * s * s)).exp()).sum();
        self.b + (1.0 + u * u).powf(-self.p) + bumps
    }

    /// The normal deviate of frame `k`: Box and Muller on the splitmix64 finaliser.
    fn deviate(&self, k: u32) -> f64 {
        let uniform = |j: u64| {
            let seed = self.id.wrapping_mul(0xD134_2543_DE82_EF95).wrapping_add(j.wrapping_mul(0x9E37_79B9_7F4A_7C15));
            ((mix64(seed) >> 11) as f64 + 0.5) / (1u64 << 53) as f64
        };
        let k = u64::from(k);
        (-2.0 * uniform(2 * k + 1).ln()).sqrt() * (2.0 * std::f64::consts::PI * uniform(2 * k + 2)).cos()
    }

    fn frame(&self, k: u32, z: Nanometres, noise: f64) -> f64 {
        self.phi(z.micrometres().0) * (1.0 + if noise > 0.0 { noise * self.deviate(k) } else { 0.0 })
    }

    /// Positions in order, µm, and frames.
    fn run(&self, by: By, z0: f64, noise: f64, j0: f64) -> Result<(Vec<f64>, u32)> {
        let named = |strategy| self.board(strategy, z0, noise, j0);
        match by {
            By::Climb => named(Strategy::Climb),
            By::Mixed => named(Strategy::Mixed),
            By::Scan => named(Strategy::Scan),
            By::Golden => Ok(self.other(&mut Golden::default(), z0, noise)),
            By::CoarseFine => Ok(self.other(&mut CoarseFine::default(), z0, noise)),
            By::Brent => Ok(self.other(&mut Brent::default(), z0, noise)),
        }
    }

    /// The board's own scan, frame by frame.
    fn board(&self, strategy: Strategy, z0: f64, noise: f64, j0: f64) -> Result<(Vec<f64>, u32)> {
        let parameters = ScanParameters {
            scan: ScanId(1),
            axis: Axis(0),
            strategy,
            mode: Mode::Step,
            subject: Subject::Peak,
            low: nm(-self.r),
            high: nm(self.r),
            sample_step: nm(STEP),
            trap: nm(TRAP),
            probe: nm(j0),
            speed: MicrometresPerSecond(0.0),
            sample_timeout: Milliseconds(1_000),
            verify: false,
        };
        let Ok((mut scan, mut ask)) = Scan::begin(&parameters, nm(z0)) else {
            bail!("curve {}: the scan's parameters are refused", self.id)
        };
        let (mut way, mut frames) = (vec![z0], 0);
        loop {
            ask = match ask {
                Ask::Sample { z } => {
                    way.push(z.micrometres().0);
                    frames += 1;
                    scan.sample(z, Ok(FocusValue(self.frame(frames - 1, z, noise))))
                }
                Ask::Go { z } => {
                    way.push(z.micrometres().0);
                    scan.arrived(z)
                }
                Ask::Ended(_) => return Ok((way, frames)),
                Ask::Sweep { .. } | Ask::Wait => bail!("curve {}: a stepwise scan wants to sweep", self.id),
            };
        }
    }

    /// Another's search; its answer is its largest sample.
    fn other(&self, search: &mut dyn Search, z0: f64, noise: f64) -> (Vec<f64>, u32) {
        let mut curve = Curve::new(nm(z0), nm(-self.r), nm(self.r), nm(STEP));
        let (way, frames) = strategies::run(search, &mut curve, |k, z| self.frame(k, Nanometres(z), noise));
        (way.iter().map(|z| f64::from(*z) / 1000.0).collect(), frames)
    }
}

/// Distance between samples, µm.
const STEP: f64 = 0.5;

/// All local maxima lie within this distance of the peak, µm.
const TRAP: f64 = 10.0;

fn mix64(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

fn nm(um: f64) -> Nanometres {
    Nanometres((um * 1000.0).round() as i32)
}

/// Runs the bench.
pub fn run(arguments: &Arguments) -> Result<()> {
    let path = &arguments.curves;
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let file: File = serde_json::from_str(&text).with_context(|| format!("{} is no file of curves", path.display()))?;
    let mut runs = Vec::new();
    eprintln!(
        "{:>6} {:>7} {:>8} {:>23} {:>7}  over budget",
        "noise", "z0", "success", "dJ median, p95, max µm", "frames"
    );
    for &noise in &arguments.noise {
        for &z0mode in &arguments.z0 {
            let mut score = Score::default();
            for curve in &file.curves {
                let z0 = match z0mode {
                    Start::Centre => 0.0,
                    Start::Random => curve.z0random,
                };
                let (way, frames) = curve.run(arguments.strategy, z0, noise, file.j0)?;
                let j = way.windows(2).map(|w| (w[1] - w[0]).abs()).sum();
                let z = way.last().copied().unwrap_or(z0);
                score.add(curve, z0, file.j0, j, frames, z);
                runs.push(Run { id: curve.id, noise, z0mode, j, frames, z });
            }
            eprintln!("{noise:>6} {:>7} {score}", format!("{z0mode:?}").to_lowercase());
        }
    }
    std::fs::write(&arguments.out, serde_json::to_string(&runs)?)
        .with_context(|| format!("cannot write {}", arguments.out.display()))
}

/// The rules of the comparison.
#[derive(Debug, Default)]
struct Score {
    successes: usize,
    over_budget: usize,
    frames: u64,
    excess: Vec<f64>,
}

impl Score {
    fn add(&mut self, curve: &Generated, z0: f64, j0: f64, j: f64, frames: u32, z: f64) {
        self.successes += usize::from((z - curve.zstar).abs() <= 1.0);
        self.over_budget += usize::from(f64::from(frames) > 2.0 * j / STEP + 100.0);
        self.frames += u64::from(frames);
        self.excess.push(j - (curve.zstar - z0).abs() - j0);
    }
}

impl std::fmt::Display for Score {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut excess = self.excess.clone();
        excess.sort_by(f64::total_cmp);
        let n = excess.len();
        if n == 0 {
            return write!(f, "no curves");
        }
        let at = |q: f64| excess[((n - 1) as f64 * q).round() as usize];
        let (success, frames) = (100.0 * self.successes as f64 / n as f64, self.frames / n as u64);
        let (median, p95, most) = (at(0.5), at(0.95), at(1.0));
        write!(f, "{success:>7.1}% {median:>7.1} {p95:>7.1} {most:>7.1} {frames:>7}  {}", self.over_budget)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_and_curve_are_those_of_the_rules() {
        let curve = Generated {
            id: 100_000,
            r: 100.0,
            zc: 53.326007910351535,
            wl: 26.754956829462195,
            wr: 37.80288990159635,
            p: 0.7324130280092997,
            b: 0.28944002401337177,
            bumps: vec![[0.2906230510705469, 55.21090224628658, 0.5853317761059196]],
            zstar: 55.2060079103519,
            z0random: -86.69408327814494,
        };
        for (k, g) in [-1.04342544, 0.15771813, -1.48204416, 0.40708557].into_iter().enumerate() {
            assert!((curve.deviate(k as u32) - g).abs() < 1e-8);
        }
        assert!((curve.phi(0.0) - 0.5983388).abs() < 1e-7);
    }
}
