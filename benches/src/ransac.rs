//! Robust point registration, scored against truth where the data has it. Formats and rules: the bench data's README.

use anyhow::Context;
use nalgebra::SVector;
use parfocal::calibration::robust::{Map, Model, ScalePrior, Settings, Solution, SolveError, solve};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

/// Solves every set of a file of point pairs.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Sets: [{"kind", "n", "out", "trial", "tol", "src", "dst", …}, …]
    #[arg(long)]
    data: PathBuf,
    /// Where the maps go
    #[arg(long)]
    out: PathBuf,
    /// Seed of the solver's random draws
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

#[derive(Deserialize)]
struct Set {
    kind: String,
    n: usize,
    out: f64,
    trial: u64,
    tol: f64,
    src: Vec<Vec<f64>>,
    dst: Vec<Vec<f64>>,
    /// For the score only; the solver never sees the rest.
    sigma: Option<f64>,
    inlier: Option<Vec<u8>>,
    truth: Option<Vec<Vec<f64>>>,
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
    let data = std::fs::read(&arguments.data).with_context(|| format!("cannot read {}", arguments.data.display()))?;
    let sets: Vec<Set> =
        serde_json::from_slice(&data).with_context(|| format!("{} holds no sets", arguments.data.display()))?;
    let mut scores = BTreeMap::new();
    let mut answers = Vec::with_capacity(sets.len());
    for set in &sets {
        let (answer, score) = match set.kind.as_str() {
            "aff2" => answer::<2>(set, Model::Affine, None, arguments.seed)?,
            // Manipulators' axes are known to a few per cent; a camera's are not.
            "aff3" | "axs3" => answer::<3>(set, Model::Affine, Some(ScalePrior::default()), arguments.seed)?,
            "rig3" => answer::<3>(set, Model::Rigid, None, arguments.seed)?,
            other => anyhow::bail!("trial {}: kind '{other}' is none of aff2, aff3, rig3, axs3", set.trial),
        };
        let key = (set.kind.clone(), set.n, (set.out * 100.0).round() as u32);
        scores.entry(key).or_insert_with(Vec::new).extend(score.map(|score| (score, answer.us)));
        answers.push(answer);
    }
    let file =
        std::fs::File::create(&arguments.out).with_context(|| format!("cannot write {}", arguments.out.display()))?;
    serde_json::to_writer(std::io::BufWriter::new(file), &answers)?;
    print_scores(&scores);
    Ok(())
}

/// How a set's map compares with the truth.
enum Score {
    /// Error over the oracle's.
    Solved(f64),
    Ambiguous,
    Wrong,
}

fn answer<const D: usize>(
    set: &Set,
    model: Model,
    prior: Option<ScalePrior>,
    seed: u64,
) -> anyhow::Result<(Answer<'_>, Option<Score>)> {
    let (src, dst) = (points::<D>(set, &set.src)?, points::<D>(set, &set.dst)?);
    let settings = Settings { tolerance: Some(set.tol), seed, prior, ..Settings::new(model) };
    let start = Instant::now();
    let solved = std::hint::black_box(solve(&src, &dst, &settings));
    let us = start.elapsed().as_secs_f64() * 1e6;
    let (map, ambiguous) = read(&solved);
    let score = score(set, model, &src, &dst, map, ambiguous);
    let map =
        map.map(|map| (0..D).map(|r| map.linear.row(r).iter().copied().chain([map.shift[r]]).collect()).collect());
    Ok((Answer { kind: &set.kind, n: set.n, out: set.out, trial: set.trial, map, us, ambiguous }, score))
}

/// The map, unless there is none or it is told to be ambiguous.
fn read<const D: usize>(solved: &Result<Solution<D>, SolveError>) -> (Option<Map<D>>, bool) {
    match solved {
        Ok(solution) if solution.ambiguity.is_none() => (Some(solution.fit.map), false),
        Ok(_) => (None, true),
        // Points that determine no map leave it open as well.
        Err(SolveError::Degenerate { .. }) => (None, true),
        Err(_) => (None, false),
    }
}

fn points<const D: usize>(set: &Set, rows: &[Vec<f64>]) -> anyhow::Result<Vec<SVector<f64, D>>> {
    let whole = |row: &Vec<f64>| (row.len() == D).then(|| SVector::from_column_slice(row));
    rows.iter().map(whole).collect::<Option<_>>().with_context(|| format!("trial {}: points are not {D}-D", set.trial))
}

/// Scores a map when the set has its truth.
fn score<const D: usize>(
    set: &Set,
    model: Model,
    src: &[SVector<f64, D>],
    dst: &[SVector<f64, D>],
    map: Option<Map<D>>,
    ambiguous: bool,
) -> Option<Score> {
    let (sigma, inlier, truth) = (set.sigma?, set.inlier.as_ref()?, set.truth.as_ref()?);
    if ambiguous {
        return Some(Score::Ambiguous);
    }
    let truth =
        Map { linear: nalgebra::SMatrix::from_fn(|r, c| truth[r][c]), shift: SVector::from_fn(|r, _| truth[r][D]) };
    let chosen: Vec<usize> = (0..src.len()).filter(|&i| inlier[i] == 1).collect();
    let oracle = error(&model.fit(src, dst, &chosen)?.map, &truth);
    let found = map.map_or(f64::INFINITY, |map| error(&map, &truth));
    Some(if found <= sigma.max(2.0 * oracle) { Score::Solved(found / oracle) } else { Score::Wrong })
}

/// RMS distance over the bench's grid.
fn error<const D: usize>(map: &Map<D>, truth: &Map<D>) -> f64 {
    let (reach, steps): (&[f64], &[usize]) =
        if D == 2 { (&[200.0, 150.0], &[5, 5]) } else { (&[300.0, 300.0, 100.0], &[5, 5, 3]) };
    let count: usize = steps.iter().product();
    let squares: f64 = (0..count)
        .map(|mut k| {
            let p = SVector::from_fn(|r, _| {
                let i = k % steps[r];
                k /= steps[r];
                reach[r] * (2.0 * i as f64 / (steps[r] - 1) as f64 - 1.0)
            });
            (map.apply(&p) - truth.apply(&p)).norm_squared()
        })
        .sum();
    (squares / count as f64).sqrt()
}

/// Scores and µs of the solves, by kind, points and per cent of wrong ones.
type Scores = BTreeMap<(String, usize, u32), Vec<(Score, f64)>>;

fn print_scores(scores: &Scores) {
    if scores.values().all(Vec::is_empty) {
        return;
    }
    eprintln!("kind   n  wrong |  sets  solved%  ambiguous%  failed% | e/e_oracle median    p95 | us median    p95");
    for ((kind, n, out), list) in scores {
        let share =
            |is: fn(&Score) -> bool| 100.0 * list.iter().filter(|(s, _)| is(s)).count() as f64 / list.len() as f64;
        let ratios = list.iter().filter_map(|(s, _)| if let Score::Solved(r) = s { Some(*r) } else { None }).collect();
        let (middle, high) = quantiles(ratios);
        let (us, us_high) = quantiles(list.iter().map(|(_, us)| *us).collect());
        eprintln!(
            "{kind} {n:>4} {out:>4} % | {:>5} {:>8.1} {:>11.1} {:>8.1} | {middle:>17.3} {high:>6.3} | {us:>9.1} {us_high:>6.1}",
            list.len(),
            share(|s| matches!(s, Score::Solved(_))),
            share(|s| matches!(s, Score::Ambiguous)),
            share(|s| matches!(s, Score::Wrong)),
        );
    }
}

/// Median and 95th percentile.
fn quantiles(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let at = |q: f64| values.get(((values.len().max(1) - 1) as f64 * q).round() as usize).copied().unwrap_or(f64::NAN);
    (at(0.5), at(0.95))
}
