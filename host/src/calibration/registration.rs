//! A manipulator's map to ref: its tip brought into focus at several of its positions.
//!
//! The textbook map is rigid. Real manipulators' axes are not orthogonal, so affine is the default, and a rigid or
//! similarity map that the points contradict is refused with the error it makes.

use super::camera::{Options, two_answers};
use super::chain::Chain;
use super::error::CalibrationError;
use super::frames::{Man, Ref, Transform};
use super::geometry::{self, Span};
use super::robust::{Map, Model, ScalePrior, Settings, Solution, SolveError, solve};
use super::samples::{RegistrationSample, Seen, on_sensor};
use super::statistics::{self, StandardErrors};
use nalgebra::Vector3;

/// A registration, and what can be read off it.
#[derive(Clone, Debug)]
pub struct RegistrationFit {
    /// The model asked for.
    pub model: Model,
    /// What the solver found, man to ref.
    pub solution: Solution<3>,
    /// The manipulator's positions, µm.
    pub man_um: Vec<Vector3<f64>>,
    /// The tips in ref, µm.
    pub ref_um: Vec<Vector3<f64>>,
    /// Standard errors; `None` when the points fit exactly by their number.
    pub standard_errors: Option<StandardErrors<3>>,
    /// Leave-one-out error of each inlier, µm; `None` where the map rests on that one.
    pub leave_one_out_um: Vec<Option<f64>>,
}

/// Axes come out of scale beyond this many standard deviations of the prior: not µm.
const NOT_UM: f64 = 6.0;
/// Smallest extent that makes sense, µm.
const LEAST_UM: f64 = 2.0;
/// A model with fewer parameters does not fit when it leaves this many times the affine model's error.
const WORSE: f64 = 2.0;

impl RegistrationFit {
    /// `T_man_ref`.
    pub fn transform(&self) -> Transform<Man, Ref> {
        let Map { linear, shift } = self.solution.fit.map;
        Transform::new(linear, shift).expect("a solution is invertible: its samples span three directions")
    }

    /// Angles between the manipulator's axes in ref, degrees: x–y, y–z, z–x.
    pub fn axis_angles_deg(&self) -> [f64; 3] {
        axis_angles_deg(&self.solution.fit.map)
    }

    /// Lengths of the manipulator's axes in ref, µm a µm.
    pub fn axis_scales(&self) -> [f64; 3] {
        std::array::from_fn(|k| self.solution.fit.map.linear.column(k).norm())
    }

    /// Whether the axes are left-handed in ref.
    pub fn mirrored(&self) -> bool {
        self.solution.fit.map.linear.determinant() < 0.0
    }

    /// Largest leave-one-out error, µm; `None` when some axis rests on one sample.
    pub fn leave_one_out_max_um(&self) -> Option<f64> {
        self.leave_one_out_um.iter().try_fold(0.0, |max: f64, e| e.map(|e| max.max(e)))
    }
}

fn axis_angles_deg(map: &Map<3>) -> [f64; 3] {
    let angle = |a: usize, b: usize| map.linear.column(a).angle(&map.linear.column(b)).to_degrees();
    [angle(0, 1), angle(1, 2), angle(2, 0)]
}

/// The tips' places in ref.
///
/// # Errors
/// [`CalibrationError::Missing`] when samples are in pixels and there is no chain; a pixel off the sensor.
pub fn places(samples: &[RegistrationSample], chain: Option<&Chain>) -> Result<Vec<Vector3<f64>>, CalibrationError> {
    let pixels: Vec<_> = samples
        .iter()
        .filter_map(|s| if let Seen::Picture { pixel, .. } = s.seen { Some(pixel) } else { None })
        .collect();
    if let (Some(chain), false) = (chain, pixels.is_empty()) {
        on_sensor(chain.sensor(), pixels)?;
    }
    samples
        .iter()
        .map(|sample| match (sample.seen, chain) {
            (Seen::Ref(place), _) => Ok(place),
            (Seen::Picture { mic_um, pixel }, Some(chain)) => Ok(chain.pixel_to_ref(mic_um, pixel).coordinates),
            (Seen::Picture { .. }, None) => Err(CalibrationError::Missing(
                "samples in pixels need the camera: give --rig FILE, or --camera-matrix a,b,c,d and --image-size WxH"
                    .into(),
            )),
        })
        .collect()
}

/// Solves a registration. `prior` is what axis scales to expect; `None` for no expectation.
///
/// # Errors
/// [`CalibrationError`], naming the row, what to move, or by how much the model does not fit.
pub fn fit(
    samples: &[RegistrationSample],
    chain: Option<&Chain>,
    model: Model,
    prior: Option<ScalePrior>,
    options: &Options,
) -> Result<RegistrationFit, CalibrationError> {
    let need = model.sample_size::<3>();
    if samples.len() < need {
        return Err(CalibrationError::TooFew { what: "a registration", have: samples.len(), need });
    }
    let man: Vec<_> = samples.iter().map(|s| s.man_um).collect();
    let place = places(samples, chain)?;
    let dimensions = if model == Model::Affine { 3 } else { 2 };
    geometry::check(&man, Span { what: "manipulator", unit: "µm", least: LEAST_UM, dimensions })?;
    geometry::check(&place, Span { what: "tip", unit: "µm", least: LEAST_UM, dimensions: 1 })?;
    let settings =
        Settings { model, tolerance: options.tolerance_um, seed: options.seed, estimator: options.estimator, prior };
    let affine = (model != Model::Affine && samples.len() > 5)
        .then(|| solve(&man, &place, &Settings { model: Model::Affine, ..settings }))
        .and_then(Result::ok)
        .filter(|affine| affine.ambiguity.is_none());
    if let Some(affine) = &affine {
        contradicts(model, affine, &man, &place)?;
    }
    // Without a tolerance of its own a stiffer model would find a few points that suit it: use the affine one's.
    let tolerance = settings.tolerance.or(affine.map(|affine| affine.tolerance));
    let solution = solve(&man, &place, &Settings { tolerance, ..settings })?;
    if let Some(ambiguity) = &solution.ambiguity {
        return Err(CalibrationError::Ambiguous(two_answers(ambiguity, &solution.inliers)));
    }
    if model != Model::Rigid {
        check_scales(&solution, prior)?;
    }
    let determined = solution.fit.map.linear.is_invertible();
    if !determined {
        return Err(SolveError::Degenerate { model: model.name() }.into());
    }
    Ok(RegistrationFit {
        model,
        standard_errors: statistics::standard_errors(model, &man, &solution),
        leave_one_out_um: statistics::leave_one_out(model, &man, &place, &solution.chosen()),
        man_um: man,
        ref_um: place,
        solution,
    })
}

/// Refuses a stiffer model that leaves far more error than the affine one over the affine one's inliers.
fn contradicts(
    model: Model,
    affine: &Solution<3>,
    man: &[Vector3<f64>],
    place: &[Vector3<f64>],
) -> Result<(), CalibrationError> {
    let chosen = affine.chosen();
    // Around the mean, as the solver does.
    let mean = man.iter().sum::<Vector3<f64>>() / man.len() as f64;
    let src: Vec<_> = man.iter().map(|p| p - mean).collect();
    let Some(fit) = model.fit(&src, place, &chosen) else { return Ok(()) };
    let residuals: Vec<f64> = chosen.iter().map(|&i| (place[i] - fit.map.apply(&src[i])).norm()).collect();
    let squares = |r: &[f64]| r.iter().map(|r| r * r).sum::<f64>();
    let freedom = |m: Model| (3 * chosen.len()).saturating_sub(m.parameters::<3>()).max(1) as f64;
    let stiff = (squares(&residuals) / freedom(model)).sqrt();
    let free = statistics::noise(Model::Affine, affine).unwrap_or(0.0);
    let visible = affine.tolerance / 4.0;
    if stiff <= WORSE * free.max(visible) {
        return Ok(());
    }
    let [xy, yz, zx] = axis_angles_deg(&affine.fit.map);
    let mirrored = affine.fit.map.linear.determinant() < 0.0;
    let scales: Vec<String> = (0..3).map(|k| format!("{:.3}", affine.fit.map.linear.column(k).norm())).collect();
    let why = if mirrored {
        "the manipulator's axes are mirrored, which no rotation is".into()
    } else {
        format!("axis angles {xy:.1}° xy, {yz:.1}° yz, {zx:.1}° zx, scales {}", scales.join(", "))
    };
    Err(CalibrationError::WrongModel {
        model: model.name(),
        rms_um: (squares(&residuals) / chosen.len() as f64).sqrt(),
        max_um: residuals.iter().copied().fold(0.0, f64::max),
        affine_rms_um: affine.rms(),
        why,
    })
}

/// Refuses axes so long or short that a column cannot be in µm.
fn check_scales(solution: &Solution<3>, prior: Option<ScalePrior>) -> Result<(), CalibrationError> {
    let Some(prior) = prior else { return Ok(()) };
    let noise = solution.tolerance / 4.0;
    for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
        let scale = solution.fit.map.linear.column(k).norm();
        let deviation = (prior.deviation.powi(2) + noise.powi(2) * solution.fit.gain[(k, k)]).sqrt();
        if (scale - prior.scale).abs() > NOT_UM * deviation {
            return Err(CalibrationError::Units(format!(
                "the manipulator's {axis} axis comes out {scale:.3} µm a µm where {} ± {} is expected: is a column in \
                 px, mm or steps? (--axis-scale {scale:.2} if the motor really does that)",
                prior.scale, prior.deviation
            )));
        }
    }
    Ok(())
}
