//! What a calibration's samples come to, and the rig with it.

use super::wizard::What;
use crate::calibration::camera::{self, Options};
use crate::calibration::chain::{Chain, Pixel, Sensor};
use crate::calibration::frames::Point;
use crate::calibration::objective;
use crate::calibration::registration;
use crate::calibration::report;
use crate::calibration::robust::{Estimator, Model, ScalePrior, Solution};
use crate::calibration::statistics;
use crate::procedure::{FramePixel, Sample, Window, what_moves};
use crate::rig::{self, CameraCalibration, ManipulatorNumber, Record, Rig, Zoom};
use nalgebra::{Matrix2, Vector3};

/// A solved calibration.
pub struct Solved {
    /// The rig with it.
    pub rig: Rig,
    /// In words.
    pub verdict: String,
    /// RMS of the samples that count.
    pub rms_um: f64,
    /// One for each sample.
    pub samples: Vec<SolvedSample>,
}

/// A sample as the solution has it.
pub struct SolvedSample {
    /// Where the solution has its point in the frame.
    pub at: FramePixel,
    /// How far that is off.
    pub residual_um: f64,
    /// Whether the solver left it out.
    pub outlier: bool,
}

/// Solves samples and puts the result into a copy of the rig.
///
/// # Errors
/// A sentence on what is wrong with the samples.
pub fn solve(rig: &Rig, what: &What, samples: &[Sample], seed: u64) -> Result<Solved, String> {
    match what {
        What::Camera(_) => solve_camera(rig, samples, seed),
        What::Registration(number) => solve_registration(rig, *number, samples, seed),
        What::Objectives(_, names) => solve_objectives(rig, names, samples, seed),
        What::IntoView(..) => Err("a tip brought into view needs no solving".into()),
    }
}

fn options(seed: u64) -> Options {
    Options { tolerance_um: None, seed, estimator: Estimator::Robust }
}

fn solve_camera(rig: &Rig, samples: &[Sample], seed: u64) -> Result<Solved, String> {
    let contents = rig.contents();
    let known = contents.camera.as_ref().ok_or("the camera has given no frame, so its size is not known")?;
    let (sensor, window) = (Sensor { width_px: known.width_px, height_px: known.height_px }, Window::of(known));
    let points: Vec<_> = samples.iter().map(Sample::camera).collect();
    let moves = what_moves(rig).map_err(|e| e.to_string())?;
    let fit = camera::fit(&points, sensor, moves, &options(seed)).map_err(|e| e.to_string())?;
    let verdict = report::camera(&fit, sensor).verdict;
    // A is kept for the default objective.
    let alpha = alpha(rig)?;
    let a = fit.matrix_um_per_px / alpha;
    let mut proposed = rig.clone();
    let objective = contents.objective_in_use.clone();
    if let Some(camera) = &mut proposed.contents_mut().camera {
        camera.calibration = Some(CameraCalibration {
            matrix_um_per_px: [[a[(0, 0)], a[(0, 1)]], [a[(1, 0)], a[(1, 1)]]],
            objective,
            record: record(&fit.solution, seed),
        });
    }
    let map = &fit.solution.fit.map;
    let back = map.linear.try_inverse().ok_or("the camera's matrix is singular")?;
    let centre = [(f64::from(sensor.width_px) - 1.0) / 2.0, (f64::from(sensor.height_px) - 1.0) / 2.0];
    let solved = |i: usize| {
        let image = back * (points[i].mic_um - map.shift);
        let pixel = Pixel { x_px: image.x + centre[0], y_px: image.y + centre[1] };
        sample(&window, pixel, &fit.solution, i)
    };
    let solved = (0..points.len()).map(solved).collect();
    Ok(Solved { rig: proposed, verdict, rms_um: fit.solution.rms(), samples: solved })
}

fn solve_registration(rig: &Rig, number: ManipulatorNumber, samples: &[Sample], seed: u64) -> Result<Solved, String> {
    let chain = Chain::of(rig).map_err(|e| e.to_string())?;
    let camera = rig.contents().camera.as_ref().ok_or("the camera is not calibrated")?;
    let window = Window::of(camera);
    let points: Vec<_> = samples.iter().filter_map(Sample::registration).collect();
    let fit = registration::fit(&points, Some(&chain), Model::Affine, Some(ScalePrior::default()), &options(seed))
        .map_err(|e| e.to_string())?;
    let verdict = report::registration(&fit).verdict;
    let transform = fit.transform();
    let mut proposed = rig.clone();
    let model = fit.model.name().to_owned();
    let found = rig::Registration { model, matrix: transform.to_rows(), record: record(&fit.solution, seed) };
    proposed.set_registration(number, found);
    let solved = points.iter().zip(samples).enumerate().map(|(i, (point, taken))| {
        let place = transform * Point::from(point.man_um);
        sample(&window, chain.ref_to_pixel(taken.mic_um, place).0, &fit.solution, i)
    });
    let solved = solved.collect();
    Ok(Solved { rig: proposed, verdict, rms_um: fit.solution.rms(), samples: solved })
}

fn solve_objectives(rig: &Rig, names: &[String], samples: &[Sample], seed: u64) -> Result<Solved, String> {
    let camera = rig.contents().camera.as_ref().ok_or("the camera is not calibrated")?;
    let (sensor, window) = (Sensor { width_px: camera.width_px, height_px: camera.height_px }, Window::of(camera));
    let [[a, b], [c, d]] = camera.calibration.as_ref().ok_or("the camera is not calibrated")?.matrix_um_per_px;
    let matrix = Matrix2::new(a, b, c, d);
    let back = matrix.try_inverse().ok_or("the camera's matrix is singular")?;
    let default = names.first().ok_or("no objectives were named")?;
    let points: Vec<_> = samples.iter().filter_map(Sample::objective).collect();
    let fits = objective::fit(&points, default, sensor, &matrix, &options(seed)).map_err(|e| e.to_string())?;
    let mut proposed = rig.clone();
    let zoom = rig.contents().zoom_in_use.unwrap_or(1.0);
    for fit in &fits {
        let record = Some(record(&fit.solution, seed));
        proposed.set_zoom(&fit.name, Zoom { zoom, alpha: fit.alpha, kappa_um: fit.kappa_um.into(), record });
    }
    // What the default objective saw says where the points are.
    let in_um = |i: usize| matrix * sensor.to_image(points[i].pixel).coordinates.xy();
    let place = |name: &str| {
        let seen: Vec<_> =
            (0..points.len()).filter(|i| points[*i].objective == *default && points[*i].point == name).collect();
        let sum: Vector3<f64> = seen.iter().map(|i| points[*i].mic_um + in_um(*i).push(0.0)).sum();
        sum / seen.len() as f64
    };
    let solved = |i: usize| {
        let point = &points[i];
        let (alpha, kappa, fit) = match fits.iter().find(|fit| fit.name == point.objective) {
            Some(fit) => (fit.alpha, fit.kappa_um, Some(fit)),
            None => (1.0, Vector3::zeros(), None),
        };
        let off = place(&point.point) - point.mic_um - kappa;
        let image = back * off.xy() / alpha;
        let at = sensor.to_pixel(Point::new(image.x, image.y, 0.0));
        let nth = fit.and_then(|fit| Some((fit, fit.rows.iter().position(|row| *row == i + 1)?)));
        match nth {
            Some((fit, k)) => sample(&window, at, &fit.solution, k),
            None => SolvedSample {
                at: window.to_frame(at),
                residual_um: (off - (alpha * in_um(i)).push(0.0)).norm(),
                outlier: false,
            },
        }
    };
    let verdict = fits.iter().map(|fit| format!("{}: {}", fit.name, report::objective(fit, default).verdict));
    let verdict = verdict.collect::<Vec<_>>().join(" ");
    let rms_um = fits.iter().map(|fit| fit.solution.rms()).fold(0.0, f64::max);
    let solved = (0..points.len()).map(solved).collect();
    Ok(Solved { rig: proposed, verdict, rms_um, samples: solved })
}

/// The objective in use against the default one.
fn alpha(rig: &Rig) -> Result<f64, String> {
    let contents = rig.contents();
    let Some(name) = contents.objective_in_use.as_ref().filter(|_| !contents.objectives.is_empty()) else {
        return if contents.objectives.is_empty() { Ok(1.0) } else { Err("the objective in use is not known".into()) };
    };
    let zoom = contents.zoom_in_use.unwrap_or(1.0);
    let objective =
        contents.objectives.get(name).ok_or_else(|| format!("objective '{name}' is not in the rig's file"))?;
    match objective.zooms.iter().find(|z| z.zoom == zoom) {
        Some(zoom) => Ok(zoom.alpha),
        None if objective.default => Ok(1.0),
        None => {
            Err(format!("'{name}' is not calibrated against the default objective: calibrate the camera with that one"))
        }
    }
}

fn sample<const D: usize>(window: &Window, pixel: Pixel, solution: &Solution<D>, i: usize) -> SolvedSample {
    SolvedSample {
        at: window.to_frame(pixel),
        residual_um: solution.residuals[i].norm(),
        outlier: !solution.inliers[i],
    }
}

fn record<const D: usize>(solution: &Solution<D>, seed: u64) -> Record {
    Record {
        date: humantime::format_rfc3339_seconds(std::time::SystemTime::now()).to_string(),
        seed: seed & i64::MAX as u64,
        samples: "clicked on the operator page".into(),
        tolerance_um: solution.tolerance,
        rms_um: solution.rms(),
        residuals_um: solution.residuals.iter().map(|r| (r.norm() * 1e4).round() / 1e4).collect(),
        rejected: (0..solution.inliers.len()).filter(|&i| !solution.inliers[i]).map(|i| i + 1).collect(),
        certainty: statistics::certainty(solution),
    }
}
