//! From placed markers to manipulators, and into the rig's file.

use super::Arguments;
use super::learning::read;
use anyhow::Context;
use nalgebra::Vector3;
use parfocal::calibration::coarse::learn::{self, Coarse, Learned, Now};
use parfocal::calibration::coarse::{Degrees, MarkerId, Registration};
use parfocal::rig::{self, CoarseRegistration, MARKERS, Markers, Rig};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The file given to `--now`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct NowFile {
    #[serde(default)]
    microscope_um: [f64; 3],
    #[serde(default)]
    joints_um: BTreeMap<u16, [f64; 3]>,
}

/// Keeps what was learned of the markers in the rig's file.
pub(super) fn keep_learned(
    arguments: &Arguments,
    rig: &mut Rig,
    learned: Learned,
    objective: Option<MarkerId>,
) -> anyhow::Result<()> {
    let (tag_mm, substrate) = (arguments.tag_mm(Some(rig)), arguments.substrate(Some(rig)));
    let empty = Markers { tag_mm, substrate, objective: None, manipulators: BTreeMap::new(), learned: None };
    let markers = rig.contents_mut().markers.get_or_insert(empty);
    markers.objective = objective.or(markers.objective);
    markers.learned = Some(learned);
    Ok(())
}

/// Where learned markers put the manipulators: into what is printed and, with a rig's file, in force there.
pub(super) fn place(
    arguments: &Arguments,
    found: &Registration,
    rig: Option<&mut Rig>,
    value: &mut Value,
    text: &mut String,
) -> anyhow::Result<()> {
    let of_rig = || rig.as_ref()?.contents().markers.as_ref()?.learned.clone();
    let learned = match &arguments.learned {
        Some(file) => Some(read::<Learned>(file)?),
        None => of_rig(),
    };
    let (Some(learned), Some(now)) = (learned, &arguments.now) else { return Ok(()) };
    let now: NowFile = read(now)?;
    let height_um = rig.as_ref().map_or(0.0, |rig| rig.contents().objective_height_um);
    let now = Now {
        // Ref stays where it is when the coarse focus knob lifts the objective and its marker.
        microscope_um: Vector3::from(now.microscope_um) + Vector3::z() * height_um,
        joints_um: now.joints_um.into_iter().map(|(id, j)| (MarkerId(id), Vector3::from(j))).collect(),
    };
    let placed = learn::place(found, &learned, &now)?;
    let mut rows = serde_json::Map::new();
    for (id, m) in &placed {
        let angle = |d: Option<Degrees>| d.map_or("unknown".into(), |d| d.to_string());
        let _ = writeln!(
            text,
            "manipulator of marker {id}: Θ {}, ψ {} (± {}), tip good to {}",
            angle(m.theta),
            angle(m.psi),
            m.direction_error,
            m.tip_error
        );
        rows.insert(id.to_string(), json!(m));
    }
    value["manipulators"] = Value::Object(rows);
    if let Some(rig) = rig {
        text.push_str(&put(rig, &placed, &now)?);
        text.push_str(&arguments.save(rig)?);
    }
    Ok(())
}

/// Puts coarse registrations in the rig. Says whose.
pub fn put(rig: &mut Rig, placed: &BTreeMap<MarkerId, Coarse>, now: &Now) -> anyhow::Result<String> {
    let mut text = String::new();
    for (id, coarse) in placed {
        let of = rig.contents().markers.as_ref().and_then(|m| m.manipulator(*id));
        let number = of.with_context(|| {
            format!(
                "whose marker {id} is, is not known: write m1 = {id}, or whichever it is, under [markers.manipulators] in the rig's file"
            )
        })?;
        let [a, b, c] = coarse.man_to_ref_um;
        let registration = CoarseRegistration {
            matrix: [a, b, c, [0.0, 0.0, 0.0, 1.0]],
            error_um: coarse.tip_error.0 * 1000.0,
            error_deg: coarse.direction_error.0,
            joints_um: now.joints_um.get(id).copied().unwrap_or_default().into(),
            date: super::super::calibrate::now(),
        };
        let pipette = coarse.theta.zip(coarse.psi).map(|(theta, psi)| rig::Pipette {
            descent_deg: theta.0,
            azimuth_deg: psi.0,
            source: MARKERS.into(),
            date: super::super::calibrate::now(),
        });
        let known = pipette.is_some();
        let taken = rig.set_coarse(number, registration, pipette);
        let _ = writeln!(
            text,
            "{number}: coarse registration, tip good to {}{}",
            coarse.tip_error,
            if known && !taken { "; its pipette's direction stays, it is known better" } else { "" }
        );
    }
    Ok(text)
}
