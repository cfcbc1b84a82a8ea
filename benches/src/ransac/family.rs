//! Sets of the bench's family with seeds of one's own: what its README says of the kinds, drawn anew.
//!
//! Every set has `n` pairs, of which the share `out` is wrong. Sources fill a box, or lie along one axis at a time; targets are the
//! true map's with gaussian noise in each coordinate; wrong ones are uniform over the picture (aff2) or over the true targets' box and 200
//! around it.

use super::set::Set;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3, Vector4};
use parfocal::calibration::robust::Map;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Points in a set, and shares of wrong ones.
const POINTS: [usize; 2] = [10, 50];
const WRONG: [f64; 4] = [0.0, 0.1, 0.3, 0.5];
/// How far beyond the true targets a wrong one may lie.
const BEYOND: f64 = 200.0;

/// `trials` sets of every kind, number of points and share of wrong ones.
pub fn generate(trials: u64, seed: u64) -> Vec<Set> {
    let mut sets = Vec::new();
    let mut cell = 0u64;
    for kind in ["aff2", "aff3", "rig3", "axs3"] {
        for n in POINTS {
            for out in WRONG {
                cell += 1;
                for trial in 0..trials {
                    // One generator a set, so that a set does not depend on how many come before it.
                    let name = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(cell << 32 | trial);
                    let mut rng = Pcg64::seed_from_u64(name);
                    sets.push(match kind {
                        "aff2" => plane(&mut rng, n, out, trial),
                        _ => space(&mut rng, kind, n, out, trial),
                    });
                }
            }
        }
    }
    sets
}

/// A camera: µm to px, 2 px a µm, any turn, a little skew.
fn plane(rng: &mut Pcg64, n: usize, out: f64, trial: u64) -> Set {
    let turn = nalgebra::Rotation2::new(rng.random_range(0.0..std::f64::consts::TAU));
    let skew: f64 = rng.random_range(-0.01..0.01);
    let scale = Vector2::from_fn(|_, _| 2.0 * (1.0 + rng.random_range(-0.03..0.03)));
    let linear = turn.matrix() * Matrix2::new(1.0, skew.sin(), 0.0, skew.cos()) * Matrix2::from_diagonal(&scale);
    let shift = Vector2::new(960.0 + rng.random_range(-50.0..50.0), 540.0 + rng.random_range(-50.0..50.0));
    let src = (0..n).map(|_| Vector2::new(rng.random_range(-200.0..200.0), rng.random_range(-150.0..150.0))).collect();
    let picture = (Vector2::zeros(), Vector2::new(1920.0, 1080.0));
    set(rng, ("aff2", out, trial), src, &Map { linear, shift }, 0.5, Some(picture))
}

fn space(rng: &mut Pcg64, kind: &'static str, n: usize, out: f64, trial: u64) -> Set {
    let turn = UnitQuaternion::from_quaternion(Vector4::from_fn(|_, _| normal(rng)).into()).to_rotation_matrix();
    let axes = match kind {
        "aff3" => Matrix3::from_diagonal(&Vector3::from_fn(|_, _| 1.0 + rng.random_range(-0.03..0.03))),
        "axs3" => Matrix3::from_columns(&[Vector3::x(), Vector3::y(), Vector3::new(0.5, 0.0, 0.75f64.sqrt())]),
        _ => Matrix3::identity(),
    };
    let shift = Vector3::from_fn(|_, _| rng.random_range(-1000.0..1000.0));
    let place = |i: usize, rng: &mut Pcg64| match kind {
        "axs3" => {
            let reach: f64 = [150.0, 120.0, 700.0][i % 3];
            Vector3::ith(i % 3, rng.random_range(-reach..reach))
        }
        _ => Vector3::from_fn(|r, _| [300.0, 300.0, 100.0][r] * rng.random_range(-1.0..1.0)),
    };
    let src = (0..n).map(|i| place(i, rng)).collect();
    let sigma = if kind == "axs3" { 1.5 } else { 1.0 };
    set(rng, (kind, out, trial), src, &Map { linear: turn.matrix() * axes, shift }, sigma, None)
}

/// Maps the sources, adds noise, and puts some of them anywhere between the two corners, or around the true ones.
fn set<const D: usize>(
    rng: &mut Pcg64,
    (kind, out, trial): (&str, f64, u64),
    src: Vec<SVector<f64, D>>,
    truth: &Map<D>,
    sigma: f64,
    corners: Option<(SVector<f64, D>, SVector<f64, D>)>,
) -> Set {
    let n = src.len();
    let exact: Vec<SVector<f64, D>> = src.iter().map(|p| truth.apply(p)).collect();
    let around = || {
        let low = exact.iter().fold(SVector::repeat(f64::INFINITY), |m: SVector<f64, D>, p| m.inf(p));
        let high = exact.iter().fold(SVector::repeat(f64::NEG_INFINITY), |m: SVector<f64, D>, p| m.sup(p));
        (low.add_scalar(-BEYOND), high.add_scalar(BEYOND))
    };
    let (low, high) = corners.unwrap_or_else(around);
    let mut order: Vec<usize> = (0..n).collect();
    order.shuffle(rng);
    let wrong = &order[..(out * n as f64).round() as usize];
    let target = |i: usize, rng: &mut Pcg64| match wrong.contains(&i) {
        true => SVector::from_fn(|r, _| rng.random_range(low[r]..high[r])),
        false => exact[i] + SVector::from_fn(|_, _| sigma * normal(rng)),
    };
    let dst: Vec<SVector<f64, D>> = (0..n).map(|i| target(i, rng)).collect();
    let rows = |points: &[SVector<f64, D>]| -> Vec<Vec<f64>> {
        points.iter().map(|p| p.iter().map(|v| (v * 1e4).round() / 1e4).collect()).collect()
    };
    Set {
        kind: kind.into(),
        n,
        out,
        trial,
        tol: 4.0 * sigma,
        src: rows(&src),
        dst: rows(&dst),
        sigma: Some(sigma),
        inlier: Some((0..n).map(|i| u8::from(!wrong.contains(&i))).collect()),
        truth: Some(matrix(truth)),
    }
}

/// L and t side by side, row after row.
pub fn matrix<const D: usize>(map: &Map<D>) -> Vec<Vec<f64>> {
    let linear: &SMatrix<f64, D, D> = &map.linear;
    (0..D).map(|r| linear.row(r).iter().copied().chain([map.shift[r]]).collect()).collect()
}

/// A standard normal number (Box & Muller 1958).
fn normal(rng: &mut Pcg64) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}
