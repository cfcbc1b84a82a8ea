//! Robust point registration, scored against truth where the data has it. Formats and rules: the bench data's README.

mod family;
mod score;
mod set;

use anyhow::Context;
use parfocal::calibration::robust::{Estimator, Map, Model, ScalePrior, Settings, Solution, SolveError, solve};
use score::{Score, Table, score};
use serde::Serialize;
use set::Set;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Solves every set of a file of point pairs, or of freshly drawn ones.
#[derive(Debug, clap::Args)]
#[command(group(clap::ArgGroup::new("from").required(true).args(["data", "generate"])))]
pub struct Arguments {
    /// Sets: [{"kind", "n", "out", "trial", "tol", "src", "dst", …}, …]
    #[arg(long)]
    data: Option<PathBuf>,
    /// Draw this many sets of every kind, number of points and share of wrong ones instead
    #[arg(long, value_name = "TRIALS")]
    generate: Option<u64>,
    /// Seed of the sets drawn
    #[arg(long, default_value_t = 1, value_name = "SEED")]
    generate_seed: u64,
    /// Write the sets here, for other programs to solve
    #[arg(long, value_name = "FILE")]
    sets: Option<PathBuf>,
    /// Where the maps go
    #[arg(long)]
    out: Option<PathBuf>,
    /// Seed of the solver's random draws
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// robust, or plain: the textbook's loop
    #[arg(long, default_value = "robust")]
    estimator: Estimator,
    /// Solve each set this often and give the fastest time: other programs on the machine only ever slow one down
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
    /// Keep each set's tolerance from the solver: it finds one
    #[arg(long)]
    estimate_tolerance: bool,
    /// Only sets of this kind
    #[arg(long)]
    kind: Option<String>,
}

#[derive(Serialize)]
struct Answer<'a> {
    kind: &'a str,
    n: usize,
    out: f64,
    trial: u64,
    #[serde(rename = "M")]
    map: Option<Vec<Vec<f64>>>,
    us: f64,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    ambiguous: bool,
}

/// Runs the bench: answers into the file, a table of scores on stderr.
///
/// # Errors
/// When a file cannot be read or written, or a set has an unknown kind.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let mut sets = match (&arguments.data, arguments.generate) {
        (Some(file), _) => read(file)?,
        (None, trials) => family::generate(trials.unwrap_or(0), arguments.generate_seed),
    };
    sets.retain(|set| arguments.kind.as_ref().is_none_or(|kind| *kind == set.kind));
    if let Some(file) = &arguments.sets {
        write(file, &sets)?;
    }
    let mut table = Table::default();
    let mut answers = Vec::with_capacity(sets.len());
    for set in &sets {
        let (answer, score) = match set.kind.as_str() {
            "aff2" => answer::<2>(set, Model::Affine, None, arguments)?,
            // Manipulators' axes are known to a few per cent; a camera's are not.
            "aff3" | "axs3" => answer::<3>(set, Model::Affine, Some(ScalePrior::default()), arguments)?,
            "rig3" => answer::<3>(set, Model::Rigid, None, arguments)?,
            other => anyhow::bail!("trial {}: kind '{other}' is none of aff2, aff3, rig3, axs3", set.trial),
        };
        table.add(set, score, answer.us);
        answers.push(answer);
    }
    if let Some(file) = &arguments.out {
        write(file, &answers)?;
    }
    eprint!("{}", table.text());
    Ok(())
}

fn read(file: &Path) -> anyhow::Result<Vec<Set>> {
    let data = std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
    serde_json::from_slice(&data).with_context(|| format!("{} holds no sets", file.display()))
}

fn write(path: &Path, rows: &impl Serialize) -> anyhow::Result<()> {
    let file = std::fs::File::create(path).with_context(|| format!("cannot write {}", path.display()))?;
    serde_json::to_writer(std::io::BufWriter::new(file), rows)
        .with_context(|| format!("cannot write {}", path.display()))
}

fn answer<'a, const D: usize>(
    set: &'a Set,
    model: Model,
    prior: Option<ScalePrior>,
    arguments: &Arguments,
) -> anyhow::Result<(Answer<'a>, Option<Score>)> {
    let (src, dst) = (set.points::<D>(&set.src)?, set.points::<D>(&set.dst)?);
    let (seed, estimator) = (arguments.seed, arguments.estimator);
    let settings = Settings {
        tolerance: (!arguments.estimate_tolerance).then_some(set.tol),
        seed,
        prior,
        estimator,
        ..Settings::new(model)
    };
    let mut us = f64::INFINITY;
    let mut solved = None;
    for _ in 0..arguments.repeat {
        let start = Instant::now();
        solved = Some(std::hint::black_box(solve(&src, &dst, &settings)));
        us = us.min(start.elapsed().as_secs_f64() * 1e6);
    }
    let (map, ambiguous) = solved.as_ref().map_or((None, false), read_off);
    let score = score(set, model, map, ambiguous);
    let map = map.as_ref().map(family::matrix);
    Ok((Answer { kind: &set.kind, n: set.n, out: set.out, trial: set.trial, map, us, ambiguous }, score))
}

/// The map, unless there is none or it is told to be ambiguous.
fn read_off<const D: usize>(solved: &Result<Solution<D>, SolveError>) -> (Option<Map<D>>, bool) {
    match solved {
        Ok(solution) if solution.ambiguity.is_none() => (Some(solution.fit.map), false),
        Ok(_) => (None, true),
        // Points that determine no map leave it open as well.
        Err(SolveError::Degenerate { .. }) => (None, true),
        Err(_) => (None, false),
    }
}
