//! The error to expect of a move by the calibration: one standard deviation in each direction, from what the rig's file
//! keeps of every map.
//!
//! What a manipulator's samples say of its tip counts where the joints go. The camera's own error is part of a registration made
//! through it, and cancels while the microscope stands where it stood then; away from there it counts with the distance.

use super::chain::{Arm, Chain, ChainError, Pixel};
use super::frames::{Man, Point};
use crate::rig::{ManipulatorNumber, Objective, Rig};
use nalgebra::{Matrix2, Vector2, Vector3};
use parfocal_protocol::units::Micrometres;

/// The error of a tip that the registration sends to a place in the picture, with its joints at `joints` and the microscope
/// at `microscope` (P_M, µm). `None` when the rig's file does not say how well the registration is known.
pub fn tip(rig: &Rig, number: ManipulatorNumber, joints: Point<Man>, microscope: Vector3<f64>) -> Option<Micrometres> {
    let manipulator = rig.contents().manipulators.get(&number)?;
    let Some(registration) = &manipulator.registration else {
        return Arm::coarse_of(rig, number).map(|(_, error_um)| Micrometres(error_um / 3f64.sqrt()));
    };
    let certainty = registration.record.certainty.as_ref()?;
    let of_arm = certainty.error_um(joints.coordinates.as_slice())?;
    let seen_from = Vector3::from_column_slice(certainty.at.get(..3)?);
    let there = Arm::of(rig, number).ok()?.tip(seen_from.into()).coordinates;
    let of_camera = camera(rig, (microscope - there).xy()).unwrap_or(0.0);
    let of_objective = objective(rig).unwrap_or(0.0);
    Some(Micrometres((of_arm.powi(2) + of_camera.powi(2) + of_objective.powi(2)).sqrt()))
}

/// The error of the microscope that brings what is seen at `pixel` to the middle. `None` when the rig's file does not say how well
/// the camera is known.
///
/// # Errors
/// [`ChainError`], saying what to calibrate.
pub fn microscope(rig: &Rig, pixel: Pixel) -> Result<Option<Micrometres>, ChainError> {
    let chain = Chain::of(rig)?;
    let step = chain.ref_from_image(Vector3::zeros()).linear() * chain.sensor().to_image(pixel).coordinates;
    Ok(camera(rig, step.xy()).map(Micrometres))
}

/// What the camera's matrix errs over a distance in ref, µm.
fn camera(rig: &Rig, by: Vector2<f64>) -> Option<f64> {
    let calibration = rig.contents().camera.as_ref()?.calibration.as_ref()?;
    let [[a, b], [c, d]] = calibration.matrix_um_per_px;
    let px = Matrix2::new(a, b, c, d).try_inverse()? * by;
    calibration.record.certainty.as_ref()?.step_error_um(px.as_slice())
}

/// What the offset of the objective in use errs, µm: none for the default one.
fn objective(rig: &Rig) -> Option<f64> {
    let contents = rig.contents();
    let objective: &Objective = contents.objectives.get(contents.objective_in_use.as_ref()?)?;
    let zoom = contents.zoom_in_use.unwrap_or(1.0);
    let entry = objective.zooms.iter().find(|z| z.zoom == zoom)?;
    entry.record.as_ref()?.certainty.as_ref()?.error_um(&[0.0; 3])
}

#[cfg(test)]
mod tests {
    use crate::calibration::camera::Options;
    use crate::calibration::registration::fit;
    use crate::calibration::robust::{Estimator, Model, ScalePrior};
    use crate::calibration::samples::{RegistrationSample, Seen};
    use crate::calibration::statistics::certainty;
    use nalgebra::{Matrix3, Rotation3, Vector3};
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    /// A standard normal number, by the sum of twelve.
    fn normal(rng: &mut Pcg64) -> f64 {
        (0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0
    }

    #[test]
    fn the_errors_told_cover_the_true_ones_as_often_as_they_claim() {
        // Registrations of 14 places, one of them wild now and then; then the tip sent to places in and around them.
        let (mut within, mut all) = ([0usize; 2], 0usize);
        for seed in 0..300 {
            let mut rng = Pcg64::seed_from_u64(seed);
            let turn = Rotation3::from_scaled_axis(Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0)));
            let lean = Matrix3::new(1.0, 0.0, 0.5, 0.0, 1.01, 0.0, 0.0, 0.0, 0.86);
            let (linear, shift) = (turn.matrix() * lean, Vector3::new(30.0, -20.0, 5.0));
            let place = |rng: &mut Pcg64, reach: f64| Vector3::from_fn(|_, _| rng.random_range(-reach..reach));
            let samples: Vec<RegistrationSample> = (0..14)
                .map(|i| {
                    let man_um = place(&mut rng, 80.0);
                    let wild = if i == 3 && seed % 2 == 0 { Vector3::new(40.0, -25.0, 10.0) } else { Vector3::zeros() };
                    let noise = Vector3::from_fn(|_, _| 0.3 * normal(&mut rng));
                    RegistrationSample { man_um, seen: Seen::Ref(linear * man_um + shift + noise + wild) }
                })
                .collect();
            let options = Options { tolerance_um: None, seed, estimator: Estimator::Robust };
            let found = fit(&samples, None, Model::Affine, Some(ScalePrior::default()), &options).unwrap();
            let known = certainty(&found.solution).unwrap();
            for _ in 0..5 {
                let joints = place(&mut rng, 120.0);
                let map = found.solution.fit.map;
                let off = map.linear * joints + map.shift - (linear * joints + shift);
                let error = known.error_um(joints.as_slice()).unwrap();
                for off in off.iter().map(|off| off.abs() / error) {
                    all += 1;
                    within[0] += usize::from(off <= 1.0);
                    within[1] += usize::from(off <= 2.0);
                }
            }
        }
        // 68 % and 95 % for the normal distribution.
        let share = within.map(|n| 100.0 * n as f64 / all as f64);
        println!("{:.1} % within one standard error, {:.1} % within two, of {all}", share[0], share[1]);
        assert!((62.0..74.0).contains(&share[0]) && (92.0..98.0).contains(&share[1]), "{share:?} of {all}");
    }
}
