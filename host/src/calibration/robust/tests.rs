//! The solver against seeded points of known truth, and what it must refuse.

use super::*;
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// A standard normal number (Box & Muller 1958).
fn normal(rng: &mut Pcg64) -> f64 {
    let (a, b): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random());
    (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

struct Set<const D: usize> {
    src: Vec<SVector<f64, D>>,
    dst: Vec<SVector<f64, D>>,
    good: Vec<bool>,
    truth: Map<D>,
}

/// `n` points of `place`, mapped by `truth` with noise `sigma`; the share `wrong` is put anywhere within ±500.
fn set<const D: usize>(
    rng: &mut Pcg64,
    n: usize,
    wrong: f64,
    sigma: f64,
    truth: Map<D>,
    mut place: impl FnMut(&mut Pcg64, usize) -> SVector<f64, D>,
) -> Set<D> {
    let src: Vec<_> = (0..n).map(|i| place(rng, i)).collect();
    let mut dst: Vec<_> = src.iter().map(|p| truth.apply(p) + SVector::from_fn(|_, _| sigma * normal(rng))).collect();
    let mut good = vec![true; n];
    let mut left = (wrong * n as f64).round() as usize;
    while left > 0 {
        let i = rng.random_range(0..n);
        if std::mem::replace(&mut good[i], false) {
            dst[i] = truth.shift + SVector::from_fn(|_, _| rng.random_range(-500.0..500.0));
            left -= 1;
        }
    }
    Set { src, dst, good, truth }
}

fn turn(rng: &mut Pcg64) -> Matrix3<f64> {
    *Rotation3::from_scaled_axis(Vector3::from_fn(|_, _| rng.random_range(-2.0..2.0))).matrix()
}

fn anywhere(rng: &mut Pcg64, _: usize) -> Vector3<f64> {
    Vector3::new(rng.random_range(-300.0..300.0), rng.random_range(-300.0..300.0), rng.random_range(-100.0..100.0))
}

/// RMS distance between two maps over the points.
fn apart<const D: usize>(a: &Map<D>, b: &Map<D>, points: &[SVector<f64, D>]) -> f64 {
    (points.iter().map(|p| (a.apply(p) - b.apply(p)).norm_squared()).sum::<f64>() / points.len() as f64).sqrt()
}

/// Of 200 sets: how many are solved as well as least squares on the true inliers does, and how many are solved wrongly;
/// the rest is told to be ambiguous.
fn score<const D: usize>(settings: Settings, sigma: f64, mut make: impl FnMut(&mut Pcg64) -> Set<D>) -> (usize, usize) {
    let (mut solved, mut wrong) = (0, 0);
    for seed in 0..200 {
        let s = make(&mut Pcg64::seed_from_u64(seed));
        let chosen: Vec<usize> = (0..s.good.len()).filter(|&i| s.good[i]).collect();
        let Some(oracle) = settings.model.fit(&s.src, &s.dst, &chosen) else { continue };
        let found = solve(&s.src, &s.dst, &settings).unwrap();
        let best = apart(&oracle.map, &s.truth, &s.src);
        match apart(&found.fit.map, &s.truth, &s.src) <= (2.0 * best).max(sigma) {
            _ if found.ambiguity.is_some() => {}
            true => solved += 1,
            false => wrong += 1,
        }
    }
    (solved, wrong)
}

#[test]
fn ten_points_in_the_plane_survive_half_of_them_wrong() {
    for (share, tolerance, least) in
        [(0.0, Some(2.0), 197), (0.3, Some(2.0), 197), (0.5, Some(2.0), 197), (0.3, None, 190)]
    {
        let settings = Settings { tolerance, ..Settings::new(Model::Affine) };
        let (solved, wrong) = score::<2>(settings, 0.5, |rng| {
            let linear = SMatrix2::new(-0.24, 1.98, -1.93, -0.24);
            let truth = Map { linear, shift: SVector::from([900.0, 500.0]) };
            set(rng, 10, share, 0.5, truth, |rng, _| {
                SVector::from([rng.random_range(-200.0..200.0), rng.random_range(-150.0..150.0)])
            })
        });
        assert!(solved >= least, "{share} {tolerance:?}: {solved} solved, {wrong} wrong");
    }
}

type SMatrix2 = nalgebra::Matrix2<f64>;

#[test]
fn models_in_space_survive_a_third_of_ten_points_wrong() {
    for (model, share) in [(Model::Affine, 0.1), (Model::Affine, 0.3), (Model::Rigid, 0.3), (Model::Similarity, 0.3)] {
        let settings = Settings { tolerance: Some(4.0), ..Settings::new(model) };
        let (solved, wrong) = score::<3>(settings, 1.0, |rng| {
            let scale = match model {
                Model::Affine => Vector3::new(0.98, 1.03, 1.01),
                Model::Similarity => Vector3::repeat(1.4),
                _ => Vector3::repeat(1.0),
            };
            let linear = turn(rng) * Matrix3::from_diagonal(&scale);
            set(rng, 10, share, 1.0, Map { linear, shift: Vector3::new(500.0, 400.0, -300.0) }, anywhere)
        });
        assert!(solved >= 197 && wrong <= 2, "{model:?} {share}: {solved} solved, {wrong} wrong");
    }
}

#[test]
fn points_along_one_axis_at_a_time_are_solved_or_told() {
    for (share, least) in [(0.0, 198), (0.1, 198), (0.3, 180)] {
        let settings =
            Settings { tolerance: Some(6.0), prior: Some(ScalePrior::default()), ..Settings::new(Model::Affine) };
        let (solved, wrong) = score::<3>(settings, 1.5, |rng| {
            let lean = Matrix3::from_columns(&[Vector3::x(), Vector3::y(), Vector3::new(0.5, 0.0, 0.866)]);
            let truth = Map { linear: turn(rng) * lean, shift: Vector3::new(500.0, 400.0, -300.0) };
            set(rng, 10, share, 1.5, truth, |rng, i| {
                let reach = [150.0, 120.0, 700.0][i % 3];
                Vector3::ith(i % 3, rng.random_range(-reach..reach))
            })
        });
        // Sets whose every point on an axis is wrong cannot be solved by anybody; they must be told.
        assert!(solved >= least && wrong <= 3, "{share}: {solved} solved, {wrong} wrong");
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_and_far_origins_cost_no_digits() {
    let mut rng = Pcg64::seed_from_u64(5);
    let truth = Map { linear: turn(&mut rng), shift: Vector3::zeros() };
    let s = set(&mut rng, 60, 0.4, 1.0, truth, anywhere);
    let settings = Settings { tolerance: Some(4.0), seed: 9, ..Settings::new(Model::Affine) };
    let run = |far: f64| {
        let src: Vec<_> = s.src.iter().map(|p| p.add_scalar(far)).collect();
        solve(&src, &s.dst, &settings).unwrap()
    };
    let (a, b, moved) = (run(0.0), run(0.0), run(1e6));
    assert_eq!((a.fit.map, &a.inliers, a.draws), (b.fit.map, &b.inliers, b.draws));
    assert!(!a.exhaustive && a.inliers == s.good && moved.inliers == s.good);
    assert!((a.fit.map.linear - moved.fit.map.linear).abs().max() < 1e-6);
}

#[test]
fn exact_points_are_fitted_without_a_tolerance() {
    let mut rng = Pcg64::seed_from_u64(6);
    let truth = Map { linear: turn(&mut rng), shift: Vector3::new(1.0, 2.0, 3.0) };
    let s = set(&mut rng, 12, 0.25, 0.0, truth, anywhere);
    let found = solve(&s.src, &s.dst, &Settings::new(Model::Affine)).unwrap();
    assert_eq!(found.inliers, s.good);
    assert!(apart(&found.fit.map, &s.truth, &s.src) < 1e-9);
}

#[test]
fn the_plain_loop_is_there_to_compare_with() {
    let mut rng = Pcg64::seed_from_u64(1);
    let truth = Map { linear: turn(&mut rng), shift: Vector3::zeros() };
    let s = set(&mut rng, 10, 0.0, 1.0, truth, anywhere);
    let settings = Settings { estimator: Estimator::Plain, tolerance: Some(8.0), ..Settings::new(Model::Affine) };
    let found = solve(&s.src, &s.dst, &settings).unwrap();
    assert!(found.draws <= 5 && found.rms() < 4.0);
}

#[test]
fn what_does_not_determine_a_map_is_refused() {
    let line: Vec<_> = (0..8).map(|i| Vector3::new(f64::from(i), 2.0 * f64::from(i), 0.0)).collect();
    let plane: Vec<_> = (0..9).map(|i| Vector3::new(f64::from(i % 3), f64::from(i / 3), 0.0)).collect();
    let settings = Settings { tolerance: Some(1.0), ..Settings::new(Model::Affine) };
    for flat in [&line, &plane, &vec![Vector3::new(1.0, 2.0, 3.0); 6]] {
        assert_eq!(solve(flat, flat, &settings).unwrap_err(), SolveError::Degenerate { model: "affine" });
    }
    assert!(solve(&plane, &plane, &Settings { model: Model::Rigid, ..settings }).is_ok());
    assert!(matches!(solve(&plane[..3], &plane[..3], &settings), Err(SolveError::TooFew { have: 3, need: 4, .. })));
    let mut broken = plane.clone();
    broken[4].y = f64::NAN;
    assert_eq!(solve(&plane, &broken, &settings).unwrap_err(), SolveError::NotFinite(5));
    let zero = Settings { tolerance: Some(0.0), ..settings };
    assert_eq!(solve(&plane, &plane, &zero).unwrap_err(), SolveError::Tolerance);
}
