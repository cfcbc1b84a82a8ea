//! Maps against the truth, by the rules of the bench data's README.

use super::set::Set;
use nalgebra::{SMatrix, SVector};
use parfocal::calibration::robust::{Map, Model};
use std::collections::BTreeMap;

/// How a set's answer compares with the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Score {
    /// Its error over that of least squares on the true inliers; good enough.
    Solved(f64),
    /// The same, not good enough.
    Wrong(f64),
    /// Told to be ambiguous.
    Ambiguous,
    /// No answer at all.
    Missing,
}

/// Scores a map; `None` when the set does not tell its truth.
pub fn score<const D: usize>(set: &Set, model: Model, map: Option<Map<D>>, ambiguous: bool) -> Option<Score> {
    let (sigma, inlier, truth) = (set.sigma?, set.inlier.as_ref()?, set.truth.as_ref()?);
    if ambiguous {
        return Some(Score::Ambiguous);
    }
    let Some(map) = map else { return Some(Score::Missing) };
    let (src, dst) = (set.points::<D>(&set.src).ok()?, set.points::<D>(&set.dst).ok()?);
    let truth = Map { linear: SMatrix::from_fn(|r, c| truth[r][c]), shift: SVector::from_fn(|r, _| truth[r][D]) };
    let chosen: Vec<usize> = (0..src.len()).filter(|&i| inlier[i] == 1).collect();
    let oracle = model.fit(&src, &dst, &chosen).map_or(f64::INFINITY, |fit| error(&fit.map, &truth));
    let found = error(&map, &truth);
    Some(if found <= sigma.max(2.0 * oracle) { Score::Solved(found / oracle) } else { Score::Wrong(found / oracle) })
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
#[derive(Default)]
pub struct Table(BTreeMap<(String, usize, u32), Vec<(Score, f64)>>);

impl Table {
    /// Adds a set's.
    pub fn add(&mut self, set: &Set, score: Option<Score>, us: f64) {
        let key = (set.kind.clone(), set.n, (set.out * 100.0).round() as u32);
        self.0.entry(key).or_default().extend(score.map(|score| (score, us)));
    }

    /// A line for each kind, number of points and share of wrong ones; empty when no set tells its truth. The ratios are of all sets
    /// with a map, wrong ones included.
    pub fn text(&self) -> String {
        if self.0.values().all(Vec::is_empty) {
            return String::new();
        }
        let mut text: String =
            "kind   n wrong | sets  solved%  ambiguous%  failed% | e/e_oracle median    p95 | us median    p95\n"
                .into();
        for ((kind, n, out), list) in &self.0 {
            let share =
                |is: fn(&Score) -> bool| 100.0 * list.iter().filter(|(s, _)| is(s)).count() as f64 / list.len() as f64;
            let ratio = |(s, _): &(Score, f64)| match s {
                Score::Solved(r) | Score::Wrong(r) => Some(*r),
                Score::Ambiguous | Score::Missing => None,
            };
            let (middle, high) = quantiles(list.iter().filter_map(ratio).collect());
            let (us, us_high) = quantiles(list.iter().map(|(_, us)| *us).collect());
            text += &format!(
                "{kind} {n:>3} {out:>3} % | {:>4} {:>8.1} {:>11.1} {:>8.1} | {middle:>17.3} {high:>6.3} | {us:>9.1} {us_high:>6.1}\n",
                list.len(),
                share(|s| matches!(s, Score::Solved(_))),
                share(|s| matches!(s, Score::Ambiguous)),
                share(|s| matches!(s, Score::Wrong(_) | Score::Missing)),
            );
        }
        text
    }
}

/// Median and 95th percentile.
fn quantiles(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let at = |q: f64| values.get(((values.len().max(1) - 1) as f64 * q).round() as usize).copied().unwrap_or(f64::NAN);
    (at(0.5), at(0.95))
}
