//! `--dry-run` of live procedures: their moves as a table and a picture; nothing moves.

use super::folder;
use crate::cmd::Output;
use crate::cmd::live::Room;
use anyhow::Context;
use nalgebra::Vector3;
use parfocal::calibration::chain::{Arm, Chain};
use parfocal::procedure::drawing::{self, Planned};
use parfocal::procedure::{Draws, RegistrationPlan, Window};
use parfocal::rig::Rig;
use serde_json::json;
use std::fmt::Write;
use std::path::Path;

/// The margin that procedures keep to the picture's edge, as a share of its shorter side.
const MARGIN_SHARE: f64 = 0.1;

fn window(rig: &Rig) -> anyhow::Result<Window> {
    let camera = rig.contents().camera.as_ref();
    camera.map(Window::of).context(
        "the rig's file has no [camera]: its moves are drawn in its picture, so add width_px and height_px first",
    )
}

/// Moves of the camera's and the objectives' procedures: where in the picture the point is put.
///
/// # Errors
/// What is wrong with the rig's file or the folder.
pub fn microscope(room: &Room<'_>, places: usize, report: Option<&Path>, out: Output) -> anyhow::Result<()> {
    let rig = room.known()?;
    let window = window(&rig)?;
    let chain = Chain::of(&rig).ok();
    let planned = Draws::new(room.seed).in_picture(places).into_iter().map(|share| {
        let pixel = share.pixel(&window, MARGIN_SHARE * window.side_px());
        Planned { pixel, above_um: 0.0 }
    });
    let planned: Vec<Planned> = planned.collect();
    let mut text = String::from("Where the point is put in the picture, after three first places (nothing moved):\n");
    let mut rows = Vec::new();
    for (i, place) in planned.iter().enumerate() {
        write!(text, "{:>3}  {:>8.1} {:>8.1} px", i + 1, place.pixel.x_px, place.pixel.y_px)?;
        let mut row = json!({ "x_px": place.pixel.x_px, "y_px": place.pixel.y_px });
        if let Some(chain) = &chain {
            // A point in the middle of the picture, seen there: how far the microscope goes.
            let middle = window.at_share(0.5, 0.5, 0.0);
            let centre = chain.pixel_to_ref(Vector3::zeros(), middle);
            let by = chain.position_showing(centre, place.pixel);
            write!(text, "   scope.x {:+8.1} scope.y {:+8.1} µm", by.x, by.y)?;
            row["scope_um"] = json!([by.x, by.y]);
        }
        text.push('\n');
        rows.push(row);
    }
    if chain.is_none() {
        text += "How far the microscope goes for that is known when the camera is calibrated; live, small first moves tell.\n";
    }
    finish(&mut text, report, &planned, &window)?;
    out.result(&text, &json!({ "seed": room.seed, "places": rows, "moved": false }))
}

/// Moves of a registration: where in the picture and at which height the tip is put.
///
/// # Errors
/// What is wrong with the rig's file or the folder.
pub fn registration(
    room: &Room<'_>,
    plan: &RegistrationPlan,
    report: Option<&Path>,
    out: Output,
) -> anyhow::Result<()> {
    let rig = room.known()?;
    let (window, chain) = (window(&rig)?, Chain::of(&rig)?);
    let arm = Arm::of(&rig, plan.manipulator).ok();
    let planned = Draws::new(plan.seed).in_depth(plan.places).into_iter().map(|share| Planned {
        pixel: share.pixel(&window, MARGIN_SHARE * window.side_px()),
        above_um: (share.depth - 0.5) * plan.depth_um,
    });
    let planned: Vec<Planned> = planned.collect();
    let mut text = format!("Where the tip of {} is put, after four first places (nothing moved):\n", plan.manipulator);
    let mut rows = Vec::new();
    let middle = window.at_share(0.5, 0.5, 0.0);
    for (i, place) in planned.iter().enumerate() {
        let at = Vector3::new(0.0, 0.0, place.above_um);
        let by = chain.pixel_to_ref(at, place.pixel) - chain.pixel_to_ref(Vector3::zeros(), middle);
        let r = by.coordinates;
        write!(
            text,
            "{:>3}  {:>8.1} {:>8.1} px  {:+7.1} µm",
            i + 1,
            place.pixel.x_px,
            place.pixel.y_px,
            place.above_um
        )?;
        let mut row = json!({ "x_px": place.pixel.x_px, "y_px": place.pixel.y_px, "above_um": place.above_um, "ref_um": [r.x, r.y, r.z] });
        if let Some(arm) = &arm {
            let joints = (arm.ref_from_man().inverse() * by).coordinates;
            let n = plan.manipulator;
            write!(text, "   {n}.x {:+8.1} {n}.y {:+8.1} {n}.z {:+8.1} µm", joints.x, joints.y, joints.z)?;
            row["joints_um"] = json!([joints.x, joints.y, joints.z]);
        }
        text.push('\n');
        rows.push(row);
    }
    text += "µm from where the tip is in the picture's middle, in focus.\n";
    if arm.is_none() {
        text +=
            "How the joints go for that is known after a first registration; live, a small first move of each tells.\n";
    }
    finish(&mut text, report, &planned, &window)?;
    out.result(&text, &json!({ "seed": plan.seed, "places": rows, "moved": false }))
}

fn finish(text: &mut String, report: Option<&Path>, planned: &[Planned], window: &Window) -> anyhow::Result<()> {
    let Some(report) = report else {
        text.push_str("With --report DIR they are drawn into DIR/moves.svg.\n");
        return Ok(());
    };
    folder(report)?;
    let path = report.join("moves.svg");
    std::fs::write(&path, drawing::places(planned, window))
        .with_context(|| format!("cannot write {}", path.display()))?;
    writeln!(text, "Drawn in {}.", path.display())?;
    Ok(())
}
