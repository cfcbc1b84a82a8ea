//! Lenses, the cameras' relative pose and the board's poses, adjusted to all corners at once (Triggs et al. 2000).

use super::super::camera::{Lens, Side, StereoCamera};
use super::super::fit::nudge;
use super::super::lm::{Equations, Problem, minimise};
use super::start::{Guess, guess};
use super::{Corner, Fit};
use nalgebra::{DMatrix, DVector, Isometry3, Point3, SMatrix, SVector, Vector6};

/// Numbers of a lens, of a pose, and before the board's poses: two lenses, one relative pose.
const LENS: usize = 8;
const POSE: usize = 6;
const CAMERAS: usize = 2 * LENS + POSE;
/// Unknowns that one corner depends on, the relative pose only in the right picture.
const ONE: usize = LENS + 2 * POSE;

/// What is adjusted.
#[derive(Clone)]
struct Unknowns {
    lenses: [Lens; 2],
    /// Left camera to right camera.
    right: Isometry3<f64>,
    /// Board to left camera, for each pair.
    boards: Vec<Isometry3<f64>>,
}

/// The corners to be explained.
struct Bundle<'a> {
    corners: &'a [Corner],
}

/// `None` when no cameras explain the corners.
pub(super) fn adjust(corners: &[Corner], image_size: [usize; 2], pairs: usize) -> Option<Fit> {
    let Guess { lenses, right, boards } = guess(corners, image_size, pairs)?;
    let bundle = Bundle { corners };
    let found = minimise(&bundle, Unknowns { lenses, right, boards })?;
    let x = &found.unknowns;
    let misses: Vec<f64> =
        corners.iter().map(|c| x.project(c).map(|p| (p - c.pixel).norm_squared())).collect::<Option<_>>()?;
    let rms = |part: &dyn Fn(&Corner) -> bool| {
        let chosen = corners.iter().zip(&misses).filter(|(c, _)| part(c));
        let (sum, count) = chosen.fold((0.0, 0), |(sum, n), (_, miss)| (sum + miss, n + 1));
        (sum / f64::from(count.max(1))).sqrt()
    };
    let freedom = (2.0 * corners.len() as f64 - (CAMERAS + POSE * pairs) as f64).max(1.0);
    let camera = StereoCamera { image_size, left: x.lenses[0], right: x.lenses[1], left_to_right: x.right };
    Some(Fit {
        camera,
        rms_px: rms(&|_| true),
        standard_errors: standard_errors(&found.equations.normal, found.equations.cost / freedom),
        pair_rms_px: (0..pairs).map(|k| rms(&|c| c.pair == k)).collect(),
    })
}

fn standard_errors(normal: &DMatrix<f64>, variance: f64) -> [[f64; LENS]; 2] {
    let inverse = normal.clone().cholesky().map(|c| c.inverse());
    let error = |k: usize| inverse.as_ref().map_or(f64::INFINITY, |m| (m[(k, k)] * variance).sqrt());
    [std::array::from_fn(error), std::array::from_fn(|k| error(LENS + k))]
}

impl Unknowns {
    /// The corner in the frame of the camera whose picture shows it.
    fn place(&self, c: &Corner) -> (Point3<f64>, Point3<f64>) {
        let left = self.boards[c.pair] * Point3::new(c.model.x, c.model.y, 0.0);
        (left, if c.side == Side::Right { self.right * left } else { left })
    }

    fn project(&self, c: &Corner) -> Option<nalgebra::Vector2<f64>> {
        let (_, p) = self.place(c);
        (p.z > 1.0).then(|| self.lenses[c.side as usize].pixel(p.xy().coords / p.z))
    }

    /// The corner's miss, and its slopes by lens, relative pose and board's pose.
    fn look(&self, c: &Corner) -> Option<(nalgebra::Vector2<f64>, SMatrix<f64, 2, ONE>)> {
        let (left, p) = self.place(c);
        if p.z <= 1.0 {
            return None;
        }
        let lens = &self.lenses[c.side as usize];
        let (pixel, by_point) = lens.project(&p)?;
        let mut slopes = SMatrix::<f64, 2, ONE>::zeros();
        slopes.fixed_columns_mut::<LENS>(0).copy_from(&lens.slope_by_numbers(p.xy().coords / p.z));
        let mut turned = by_point;
        if c.side == Side::Right {
            // Moved in its own frame, as `nudge` does: right·exp(ξ) sends the point to R(ω × p + ρ).
            turned *= self.right.rotation.to_rotation_matrix().matrix();
            slopes.fixed_columns_mut::<3>(LENS).copy_from(&turned);
            slopes.fixed_columns_mut::<3>(LENS + 3).copy_from(&(-turned * left.coords.cross_matrix()));
        }
        turned *= self.boards[c.pair].rotation.to_rotation_matrix().matrix();
        let model = nalgebra::Vector3::new(c.model.x, c.model.y, 0.0);
        slopes.fixed_columns_mut::<3>(LENS + POSE).copy_from(&turned);
        slopes.fixed_columns_mut::<3>(LENS + POSE + 3).copy_from(&(-turned * model.cross_matrix()));
        Some((pixel - c.pixel, slopes))
    }
}

/// Where a corner's unknowns stand among all.
fn place_of(c: &Corner, local: usize) -> usize {
    match local {
        0..LENS => LENS * c.side as usize + local,
        LENS..14 => 2 * LENS + local - LENS,
        _ => CAMERAS + POSE * c.pair + local - LENS - POSE,
    }
}

impl Problem for Bundle<'_> {
    type Unknowns = Unknowns;

    fn equations(&self, at: &Unknowns) -> Option<Equations> {
        let count = CAMERAS + POSE * at.boards.len();
        let (mut cost, mut normal, mut gradient) = (0.0, DMatrix::zeros(count, count), DVector::zeros(count));
        for c in self.corners {
            let (miss, slopes) = at.look(c)?;
            cost += miss.norm_squared();
            let products: SMatrix<f64, ONE, ONE> = slopes.tr_mul(&slopes);
            let pull: SVector<f64, ONE> = slopes.tr_mul(&miss);
            for i in 0..ONE {
                let row = place_of(c, i);
                gradient[row] += pull[i];
                for j in 0..ONE {
                    normal[(row, place_of(c, j))] += products[(i, j)];
                }
            }
        }
        Some(Equations { cost, normal, gradient })
    }

    fn cost(&self, at: &Unknowns) -> Option<f64> {
        self.corners.iter().map(|c| Some((at.project(c)? - c.pixel).norm_squared())).sum()
    }

    fn moved(&self, at: &Unknowns, by: &DVector<f64>) -> Unknowns {
        let pose = |from: &Isometry3<f64>, k: usize| nudge(from, &Vector6::from_fn(|r, _| by[k + r]));
        let lens = |k: usize| {
            let mut numbers = at.lenses[k].numbers();
            numbers.iter_mut().enumerate().for_each(|(i, n)| *n += by[LENS * k + i]);
            Lens::from_numbers(numbers)
        };
        let boards = at.boards.iter().enumerate().map(|(k, b)| pose(b, CAMERAS + POSE * k)).collect();
        Unknowns { lenses: [lens(0), lens(1)], right: pose(&at.right, 2 * LENS), boards }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion, Vector2};

    #[test]
    fn slopes_are_those_of_differences() {
        let lens = Lens::from_numbers([1100.0, 1090.0, 650.0, 470.0, -0.1, 0.05, 6e-4, -4e-4]);
        let pose = |t: [f64; 3], r: [f64; 3]| {
            Isometry3::from_parts(Translation3::from(t), UnitQuaternion::from_scaled_axis(r.into()))
        };
        let at = Unknowns {
            lenses: [lens, lens],
            right: pose([-62.0, 1.0, 2.0], [0.0, 0.12, 0.01]),
            boards: vec![pose([-40.0, -30.0, 300.0], [0.3, -0.2, 0.1])],
        };
        for side in Side::BOTH {
            let corners =
                [Corner { pair: 0, side, model: Vector2::new(55.0, 20.0), pixel: Vector2::new(600.0, 400.0) }];
            let bundle = Bundle { corners: &corners };
            let (_, slopes) = at.look(&corners[0]).unwrap();
            for local in 0..ONE {
                let step = 1e-6;
                let shifted = |by: f64| {
                    let mut vector = DVector::zeros(CAMERAS + POSE);
                    vector[place_of(&corners[0], local)] = by;
                    bundle.moved(&at, &vector).project(&corners[0]).unwrap()
                };
                let by_difference = (shifted(step) - shifted(-step)) / (2.0 * step);
                let off = (by_difference - slopes.column(local)).norm();
                assert!(off < 1e-4 * (1.0 + slopes.column(local).norm()), "{side} {local}: {off}");
            }
        }
    }
}
