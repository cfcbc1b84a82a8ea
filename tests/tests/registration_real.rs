//! A real manipulator, clicked under a microscope at 14 places one axis at a time: its axes are 59.7° apart.

use parfocal::calibration::registration::{RegistrationFit, fit};
use parfocal::calibration::robust::{Estimator, Model, ScalePrior};
use parfocal::calibration::samples::{RegistrationSample, Seen, Table};
use parfocal::calibration::{CalibrationError, camera::Options};
use parfocal_tests::{parfocal, parfocal_json, shared_data};

fn file() -> String {
    shared_data("acq4_manipulator_points/manipulator1.csv").display().to_string()
}

fn samples() -> Vec<RegistrationSample> {
    Table::read(file().as_ref()).unwrap().registration().unwrap()
}

fn solve(samples: &[RegistrationSample], seed: u64) -> Result<RegistrationFit, CalibrationError> {
    let options = Options { tolerance_um: None, seed, estimator: Estimator::Robust };
    fit(samples, None, Model::Affine, Some(ScalePrior::default()), &options)
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn the_affine_map_keeps_all_points_and_shows_the_oblique_axes() {
    let folder = tempfile::tempdir().unwrap();
    let report = folder.path().join("report");
    let (code, said) =
        parfocal_json(&["calibrate", "registration", "--samples", &file(), "--report", report.to_str().unwrap()]);
    assert_eq!(code, 0, "{said}");
    assert!(said["rms_um"].as_f64().unwrap() <= 1.86, "{said}");
    assert_eq!(said["inliers"], serde_json::json!(vec![true; 14]));
    let angle = said["axis_angles_deg"]["zx"].as_f64().unwrap();
    assert!((angle - 59.7).abs() <= 0.3, "{angle}");
    assert_eq!(said["mirrored"], false, "{said}");
    let matrix = said["matrix"].as_array().unwrap();
    assert!(matrix.len() == 4 && matrix.iter().all(|row| row.as_array().unwrap().len() == 4), "{said}");
    for key in ["model", "axis_scales", "max_um", "leave_one_out_max_um"] {
        assert!(said.get(key).is_some(), "{key} is missing: {said}");
    }
    for name in ["report.md", "residuals.csv", "picture.svg", "residuals.svg", "axes.svg"] {
        assert!(report.join(name).metadata().unwrap().len() > 100, "{name}");
    }
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn a_rigid_map_is_refused_with_the_error_it_makes() {
    let output =
        parfocal().args(["calibrate", "registration", "--model", "rigid", "--samples", &file()]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1));
    assert!(
        said.contains("the rigid model does not fit") && said.contains("µm rms") && said.contains("59.7°"),
        "{said}"
    );
}

/// The finaliser of splitmix64, for draws that need no generator.
fn mix(i: u64) -> u64 {
    let mut z = i.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[test]
#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]
fn four_displaced_points_are_rejected_and_the_fit_is_that_of_the_rest() {
    let clean = samples();
    let (draws, mut exact, mut told) = (300u64, 0, 0);
    for seed in 0..draws {
        let uniform = |k: u64| (mix(seed * 1000 + k) >> 11) as f64 / (1u64 << 53) as f64;
        // Four rows, at most one of the last three, which alone carry the z axis.
        let mut rows: Vec<usize> = Vec::new();
        for k in 0.. {
            let row = (uniform(k) * 14.0) as usize;
            if !rows.contains(&row) && (row < 11 || rows.iter().all(|r| *r < 11)) {
                rows.push(row);
            }
            if rows.len() == 4 {
                break;
            }
        }
        let mut spoilt = clean.clone();
        for (j, row) in rows.iter().enumerate() {
            let j = 100 + 4 * j as u64;
            let (z, turn) = (2.0 * uniform(j) - 1.0, std::f64::consts::TAU * uniform(j + 1));
            let across = (1.0f64 - z * z).sqrt();
            let Seen::Ref(place) = &mut spoilt[*row].seen else { panic!("these points are in ref") };
            let length = 50.0 + 450.0 * uniform(j + 2);
            for (p, d) in place.iter_mut().zip([across * turn.cos(), across * turn.sin(), z]) {
                *p += length * d;
            }
        }
        rows.sort_unstable();
        // What two maps explain as well is told, not guessed.
        let Ok(found) = solve(&spoilt, seed) else {
            told += 1;
            continue;
        };
        let rejected: Vec<usize> = (0..14).filter(|i| !found.solution.inliers[*i]).collect();
        if rejected != rows {
            println!("seed {seed}: {rows:?} were displaced, {rejected:?} rejected");
            continue;
        }
        exact += 1;
        let rest: Vec<_> = (0..14).filter(|i| !rows.contains(i)).map(|i| clean[i]).collect();
        let all = Options { tolerance_um: Some(100.0), seed, estimator: Estimator::Robust };
        let alone = fit(&rest, None, Model::Affine, None, &all).unwrap();
        let far = (found.transform().to_homogeneous() - alone.transform().to_homogeneous()).abs();
        assert!(far.fixed_view::<3, 3>(0, 0).max() < 1e-9 && far.max() < 1e-4, "seed {seed}: {far}");
    }
    println!("{exact} of {draws} exact, {told} told to be ambiguous");
    // 2,998 of 3,000 when this was written, the others told. A wrong map breaks glass: there is none.
    assert!(exact >= 298 && exact + told == draws, "{exact} of {draws} exact, {told} told to be ambiguous");
}
