//! Scans on generated focus curves: how sure and how short they are.
//!
//! Reads or makes curves, runs strategies on each with multiplicative noise, prints a table and writes one record a run: way
//! J, frames, final z. Scored are success (|z − zstar| ≤ 1 µm), dJ = J − |zstar − z0| − J0, and whether a run took more than
//! 2·J/0.5 µm + 100 frames.

mod curves;
mod family;
mod runs;
mod score;

use anyhow::{Context, Result, ensure};
use curves::{Curves, Truth};
use runs::{By, Walk};
use score::Score;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Distance between samples, µm.
const STEP: f64 = 0.5;

/// All local maxima lie within this distance of the peak, µm.
const TRAP: f64 = 10.0;

/// Scans on generated focus curves: success and travel of each strategy
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo xtask bench autofocus --generate 5000                        the default strategy on 5,000 curves
  cargo xtask bench autofocus --generate 500 --strategy all          all strategies side by side
  cargo xtask bench autofocus --curves curves.json --out runs.json   a file's curves, every run written down

Columns: success: ended within 1 µm of the highest place. dJ: travel, the last move included, less the way from the start to
the peak and 5 µm for a probe. most: the largest dJ of starts further than 20 µm from the peak (far) and of the others (near).
frames: their mean; over budget: runs with more than 2·J/0.5 µm + 100 frames.")]
pub struct Arguments {
    /// File of curves, as `--keep` writes it
    #[arg(long, value_name = "FILE", required_unless_present = "generate")]
    curves: Option<PathBuf>,
    /// Make so many curves instead
    #[arg(long, value_name = "N", conflicts_with = "curves", value_parser = clap::value_parser!(u32).range(1..))]
    generate: Option<u32>,
    /// Which ones to make
    #[arg(long, default_value_t = 1, requires = "generate")]
    seed: u64,
    /// Write the curves that were made
    #[arg(long, value_name = "FILE", requires = "generate")]
    keep: Option<PathBuf>,
    /// Standard deviations of the values, relative to the value
    #[arg(long, value_delimiter = ',', default_value = "0,0.001,0.01", value_parser = noise)]
    noise: Vec<f64>,
    /// Where the scans start
    #[arg(long, value_delimiter = ',', default_value = "centre,random")]
    z0: Vec<Start>,
    /// How they look for the peak
    #[arg(long, value_delimiter = ',', default_value = "climb")]
    strategy: Vec<Choice>,
    /// Print each position of this curve's scans on its way instead, and the value there
    #[arg(long, value_name = "ID")]
    trace: Option<u64>,
    /// Write every run as JSON: [{"id", "noise", "z0mode", "J", "frames", "z"}, …], and "strategy" if there are several
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Start {
    /// The middle of the range
    Centre,
    /// Anywhere in it
    Random,
}

/// One strategy or all of them.
#[derive(Clone, Copy, Debug)]
enum Choice {
    One(By),
    All,
}

impl clap::ValueEnum for Choice {
    fn value_variants<'a>() -> &'a [Self] {
        const {
            &[
                Self::One(By::Climb),
                Self::One(By::Mixed),
                Self::One(By::Scan),
                Self::One(By::Golden),
                Self::One(By::CoarseFine),
                Self::One(By::Brent),
                Self::All,
            ]
        }
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        match self {
            Self::One(by) => by.to_possible_value(),
            Self::All => Some(clap::builder::PossibleValue::new("all").help("All of them")),
        }
    }
}

fn noise(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(noise) if (0.0..1.0).contains(&noise) => Ok(noise),
        _ => Err("a share of the value, from 0 to below 1: 0.01 is 1 %".into()),
    }
}

/// One scan, µm.
#[derive(Debug, Serialize)]
struct Record {
    id: u64,
    noise: f64,
    z0mode: Start,
    #[serde(skip_serializing_if = "Option::is_none")]
    strategy: Option<By>,
    #[serde(rename = "J")]
    j: f64,
    frames: u32,
    z: f64,
}

/// Runs the bench.
///
/// # Errors
/// When a file cannot be read or written.
pub fn run(arguments: &Arguments) -> Result<()> {
    let mut curves = arguments.curves()?;
    if let Some(id) = arguments.trace {
        curves.curves.retain(|curve| curve.id == id);
        ensure!(!curves.curves.is_empty(), "there is no curve {id}");
    }
    let strategies = arguments.strategies();
    let several = strategies.len() > 1;
    let mut records = Vec::new();
    eprintln!("{:>11} {:>7} {:>7} {}", "strategy", "noise", "z0", score::HEAD);
    for &by in &strategies {
        for &noise in &arguments.noise {
            for &z0mode in &arguments.z0 {
                let mut score = Score::default();
                for curve in &curves.curves {
                    let z0 = match z0mode {
                        Start::Centre => 0.0,
                        Start::Random => curve.z0random,
                    };
                    let walk = runs::run(curve, by, z0, noise, curves.j0)?;
                    if arguments.trace.is_some() {
                        trace(curve, &walk);
                    }
                    score.add(curve, z0, curves.j0, &walk);
                    let (j, frames, z) = (walk.travel(), walk.frames, walk.end());
                    records.push(Record { id: curve.id, noise, z0mode, strategy: several.then_some(by), j, frames, z });
                }
                let names = (format!("{by:?}").to_lowercase(), format!("{z0mode:?}").to_lowercase());
                eprintln!("{:>11} {noise:>7} {:>7} {score}", names.0, names.1);
            }
        }
    }
    arguments.out.as_ref().map_or(Ok(()), |path| write(path, &records))
}

impl Arguments {
    fn curves(&self) -> Result<Curves> {
        let made = match (&self.curves, self.generate) {
            (Some(path), _) => Curves::read(path)?,
            (None, count) => family::curves(count.unwrap_or(0), self.seed),
        };
        ensure!(!made.curves.is_empty(), "there are no curves");
        self.keep.as_ref().map_or(Ok(()), |path| write(path, &made))?;
        Ok(made)
    }

    fn strategies(&self) -> Vec<By> {
        let mut chosen = Vec::new();
        for choice in &self.strategy {
            match choice {
                Choice::One(by) => chosen.push(*by),
                Choice::All => chosen.extend(<By as clap::ValueEnum>::value_variants()),
            }
        }
        chosen.sort_by_key(|by| *by as u8);
        chosen.dedup();
        chosen
    }
}

fn trace(curve: &Truth, walk: &Walk) {
    for z in &walk.way {
        println!("{z:>9.3} {:>+9.3} {:.6}", z - curve.zstar, curve.phi(*z));
    }
}

fn write(path: &Path, value: &impl Serialize) -> Result<()> {
    std::fs::write(path, serde_json::to_string(value)?).with_context(|| format!("cannot write {}", path.display()))
}
