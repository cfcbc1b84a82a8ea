//! What a `rig.toml` must satisfy beyond its types. Every refusal names the key.

use super::RigError;
use super::contents::{Camera, Contents, Manipulator, Moves, Objective, Obstacle, Record, SCHEMA};
use super::markers::Markers;
use super::names::Device;
use std::collections::BTreeMap;

/// Refuses what would move the wrong axis or send a tip to a wrong place.
pub fn check(contents: &Contents) -> Result<(), RigError> {
    if contents.schema == 0 || contents.schema > SCHEMA {
        return Err(RigError::Schema { found: contents.schema });
    }
    boards_and_axes(contents)?;
    if let Some(camera) = &contents.camera {
        check_camera(camera)?;
    }
    objectives(contents)?;
    for (number, manipulator) in &contents.manipulators {
        check_manipulator(&format!("manipulators.{number}"), manipulator)?;
    }
    finite("objective_height_um", &[contents.objective_height_um])?;
    if let Some(markers) = &contents.markers {
        check_markers(markers)?;
    }
    for (i, obstacle) in contents.obstacles.iter().enumerate() {
        check_obstacle(&format!("obstacle[{i}]"), obstacle, contents)?;
    }
    Ok(())
}

fn wrong(key: impl Into<String>, why: impl Into<String>) -> RigError {
    RigError::Value { key: key.into(), why: why.into() }
}

fn ensure(holds: bool, key: impl Into<String>, why: &str) -> Result<(), RigError> {
    if holds { Ok(()) } else { Err(wrong(key, why)) }
}

fn finite(key: &str, values: &[f64]) -> Result<(), RigError> {
    ensure(values.iter().all(|v| v.is_finite()), key, "holds a number that is not finite")
}

fn boards_and_axes(contents: &Contents) -> Result<(), RigError> {
    let mut ids = BTreeMap::new();
    for (name, board) in &contents.boards {
        if let Some(other) = ids.insert(&board.unique_id, name) {
            return Err(wrong(
                format!("boards.{name}.unique_id"),
                format!("is the same as that of boards.{other}: one board, one entry"),
            ));
        }
    }
    let mut taken = BTreeMap::new();
    for (device, axes) in &contents.axes {
        for (coordinate, axis) in axes {
            let key = format!("axes.{device}.{coordinate}");
            if !contents.boards.contains_key(&axis.board) {
                let known: Vec<_> = contents.boards.keys().map(String::as_str).collect();
                return Err(wrong(
                    format!("{key}.board"),
                    format!("names '{}', but the boards are: {}", axis.board, known.join(", ")),
                ));
            }
            if let Some(other) = taken.insert((&axis.board, axis.index), key.clone()) {
                return Err(wrong(
                    format!("{key}.index"),
                    format!("is axis {} of board '{}', which {other} has already", axis.index, axis.board),
                ));
            }
            match (device, axis.moves) {
                (Device::Manipulator(_), Some(_)) => {
                    return Err(wrong(format!("{key}.moves"), "is for the microscope's axes only: leave it out"));
                }
                (Device::Scope, None) => {
                    return Err(wrong(
                        format!("{key}.moves"),
                        "is missing: write moves = \"objective\" if the lens moves or moves = \"stage\" if the sample does",
                    ));
                }
                (Device::Scope, Some(Moves::Objective | Moves::Stage)) | (Device::Manipulator(_), None) => {}
            }
        }
        let boards: Vec<_> = axes.values().map(|axis| &axis.board).collect();
        let together = boards.windows(2).all(|pair| pair[0] == pair[1]);
        if matches!(device, Device::Manipulator(_)) && !together {
            return Err(wrong(format!("axes.{device}"), "is spread over boards: a manipulator's axes share one board"));
        }
    }
    Ok(())
}

fn check_camera(camera: &Camera) -> Result<(), RigError> {
    ensure(camera.width_px > 1, "camera.width_px", "must be the sensor's columns, at least 2")?;
    ensure(camera.height_px > 1, "camera.height_px", "must be the sensor's rows, at least 2")?;
    ensure((1..=16).contains(&camera.binning), "camera.binning", "must be 1 to 16")?;
    if let Some([x, y, w, h]) = camera.crop_px {
        let inside = |start: u32, length: u32, whole: u32| {
            length > 0 && start.checked_add(length).is_some_and(|end| end <= whole)
        };
        let fits = inside(x, w, camera.width_px) && inside(y, h, camera.height_px);
        ensure(fits, "camera.crop_px", "leaves the sensor: write [left, top, width, height] inside it")?;
    }
    if let Some(calibration) = &camera.calibration {
        let key = "camera.calibration.matrix_um_per_px";
        let [[a, b], [c, d]] = calibration.matrix_um_per_px;
        finite(key, &[a, b, c, d])?;
        let size = a.hypot(c) * b.hypot(d);
        ensure((a * d - b * c).abs() > 1e-3 * size, key, "is singular: its columns must not be parallel nor zero")?;
        check_record("camera.calibration.record", &calibration.record)?;
    }
    if let Some(latency) = &camera.latency {
        finite("camera.latency", &[latency.latency_ms, latency.error_ms, latency.period_ms])?;
        ensure(latency.period_ms > 0.0, "camera.latency.period_ms", "must be the time between frames, above 0")?;
        let possible = latency.latency_ms.abs() <= 10_000.0;
        ensure(possible, "camera.latency.latency_ms", "must lie between -10000 and 10000 ms")?;
    }
    Ok(())
}

fn objectives(contents: &Contents) -> Result<(), RigError> {
    if let Some(name) = &contents.objective_in_use
        && !contents.objectives.contains_key(name)
    {
        let known: Vec<_> = contents.objectives.keys().map(String::as_str).collect();
        let why = format!("names '{name}', but the objectives are: {}", known.join(", "));
        return Err(wrong("objective_in_use", why));
    }
    if let Some(zoom) = contents.zoom_in_use {
        ensure(zoom.is_finite() && zoom > 0.0, "zoom_in_use", "must be above 0")?;
    }
    let defaults: Vec<_> = contents.objectives.iter().filter(|(_, o)| o.default).map(|(name, _)| name).collect();
    if let [_, second, ..] = defaults[..] {
        return Err(wrong(
            format!("objectives.{second}.default"),
            "is true for a second objective: only one has α = 1",
        ));
    }
    contents.objectives.iter().try_for_each(|(name, objective)| check_objective(name, objective))
}

fn check_objective(name: &str, objective: &Objective) -> Result<(), RigError> {
    if let Some(depth) = objective.depth_of_field_um {
        ensure(depth.is_finite() && depth > 0.0, format!("objectives.{name}.depth_of_field_um"), "must be above 0")?;
    }
    for (i, zoom) in objective.zooms.iter().enumerate() {
        let key = format!("objectives.{name}.zoom[{i}]");
        ensure(zoom.zoom.is_finite() && zoom.zoom > 0.0, format!("{key}.zoom"), "must be above 0")?;
        ensure(zoom.alpha.is_finite() && zoom.alpha > 0.0, format!("{key}.alpha"), "must be above 0")?;
        finite(&format!("{key}.kappa_um"), &zoom.kappa_um)?;
        let twice = objective.zooms[..i].iter().any(|other| other.zoom == zoom.zoom);
        ensure(!twice, format!("{key}.zoom"), "is there twice: one entry for each zoom")?;
        if objective.default && zoom.zoom == 1.0 {
            let identity = zoom.alpha == 1.0 && zoom.kappa_um == [0.0; 3];
            ensure(identity, key.clone(), "is the default objective's: its alpha is 1 and its kappa_um [0, 0, 0]")?;
        }
        if let Some(record) = &zoom.record {
            check_record(&format!("{key}.record"), record)?;
        }
    }
    Ok(())
}

/// Every body has a marker of its own.
fn check_markers(markers: &Markers) -> Result<(), RigError> {
    ensure(markers.tag_mm > 0.1 && markers.tag_mm < 1000.0, "markers.tag_mm", "must be 0.1 to 1000")?;
    let bodies =
        [("markers.substrate".to_owned(), Some(markers.substrate)), ("markers.objective".into(), markers.objective)];
    let arms = markers.manipulators.iter().map(|(number, id)| (format!("markers.manipulators.{number}"), Some(*id)));
    let mut seen = BTreeMap::new();
    for (key, id) in bodies.into_iter().chain(arms) {
        let Some(id) = id else { continue };
        ensure(id.0 <= 586, &key, "must be 0 to 586: the family tag36h11 has no more")?;
        if let Some(other) = seen.insert(id, key.clone()) {
            return Err(wrong(
                key,
                format!("is marker {id}, which is {other} already: every body needs a number of its own"),
            ));
        }
    }
    Ok(())
}

/// A map from joints to ref.
fn check_map(key: &str, rows: &[[f64; 4]; 4]) -> Result<(), RigError> {
    let m = nalgebra::Matrix4::from_fn(|r, c| rows[r][c]);
    finite(key, m.as_slice())?;
    ensure(rows[3] == [0.0, 0.0, 0.0, 1.0], key, "must end with the row [0, 0, 0, 1]")?;
    let linear = m.fixed_view::<3, 3>(0, 0);
    let size: f64 = linear.column_iter().map(|c| c.norm()).product();
    let why = "is singular: its first three columns must not lie in a plane";
    ensure(linear.determinant().abs() > 1e-3 * size, key, why)
}

fn check_manipulator(key: &str, manipulator: &Manipulator) -> Result<(), RigError> {
    if let Some(coarse) = &manipulator.coarse {
        check_map(&format!("{key}.coarse.matrix"), &coarse.matrix)?;
        finite(&format!("{key}.coarse.joints_um"), &coarse.joints_um)?;
        ensure(
            coarse.error_um > 0.0 && coarse.error_um.is_finite(),
            format!("{key}.coarse.error_um"),
            "must be above 0",
        )?;
        ensure(coarse.error_deg >= 0.0, format!("{key}.coarse.error_deg"), "must not be negative")?;
    }
    if let Some(registration) = &manipulator.registration {
        check_map(&format!("{key}.registration.matrix"), &registration.matrix)?;
        let model = registration.model.as_str();
        let known = ["affine", "similarity", "rigid"].contains(&model);
        ensure(known, format!("{key}.registration.model"), "must be affine, similarity or rigid")?;
        check_record(&format!("{key}.registration.record"), &registration.record)?;
    }
    if let Some(pipette) = &manipulator.pipette {
        let descent = (-90.0..=90.0).contains(&pipette.descent_deg);
        ensure(descent, format!("{key}.pipette.descent_deg"), "must be -90 to 90")?;
        let azimuth = (-360.0..=360.0).contains(&pipette.azimuth_deg);
        ensure(azimuth, format!("{key}.pipette.azimuth_deg"), "must be -360 to 360")?;
    }
    for (i, tip) in manipulator.tip_offsets.iter().enumerate() {
        finite(&format!("{key}.tip_offset[{i}].offset_um"), &tip.offset_um)?;
    }
    Ok(())
}

fn check_record(key: &str, record: &Record) -> Result<(), RigError> {
    finite(&format!("{key}.residuals_um"), &record.residuals_um)?;
    finite(key, &[record.rms_um, record.tolerance_um])?;
    ensure(record.seed <= i64::MAX as u64, format!("{key}.seed"), "must be below 2^63")
}

fn check_obstacle(key: &str, obstacle: &Obstacle, contents: &Contents) -> Result<(), RigError> {
    match obstacle {
        Obstacle::Box { min_um, max_um, .. } => {
            finite(key, &[*min_um, *max_um].concat())?;
            let ordered = min_um.iter().zip(max_um).all(|(low, high)| low < high);
            ensure(ordered, format!("{key}.max_um"), "must be above min_um in x, y and z")
        }
        Obstacle::HalfSpace { point_um, normal, .. } => {
            finite(key, &[*point_um, *normal].concat())?;
            ensure(*normal != [0.0; 3], format!("{key}.normal"), "must point to where tips may be, not be zero")
        }
        Obstacle::Floor { z_um, .. } => finite(&format!("{key}.z_um"), &[*z_um]),
        Obstacle::Cone { objective, working_distance_um, front_radius_um, half_angle_deg, .. } => {
            finite(key, &[*working_distance_um, *front_radius_um, *half_angle_deg])?;
            let known = contents.objectives.contains_key(objective);
            ensure(known, format!("{key}.objective"), "names an objective that is not in this file")?;
            ensure(*working_distance_um != 0.0, format!("{key}.working_distance_um"), "must not be 0")?;
            ensure(*front_radius_um >= 0.0, format!("{key}.front_radius_um"), "must not be negative")?;
            let side = (0.0..90.0).contains(half_angle_deg);
            ensure(side, format!("{key}.half_angle_deg"), "must be 0 to below 90")
        }
    }
}
