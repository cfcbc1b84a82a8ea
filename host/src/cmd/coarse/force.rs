//! From placed markers to manipulators, and into the rig's file.

use super::Arguments;
use super::folder::{self, NowFile};
use super::learning::read;
use anyhow::{Context, bail};
use nalgebra::Vector3;
use parfocal::calibration::chain::Arm;
use parfocal::calibration::coarse::learn::{self, Coarse, Learned, Now, RefFrame};
use parfocal::calibration::coarse::{Degrees, MarkerId, Registration};
use parfocal::rig::{self, CoarseRegistration, MARKERS, Markers, Rig};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;

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
    let beside = || folder::beside(arguments.pairs.as_deref()?, folder::NOW);
    let now = arguments.now.clone().or_else(beside);
    let now = match (&learned, now) {
        (Some(_), Some(now)) => now,
        (Some(_), None) if arguments.learned.is_some() => {
            bail!("where the axes stood is not known: give --now FILE, or a folder of pairs with a now.json")
        }
        _ => return Ok(()),
    };
    let now = read::<NowFile>(&now)?.now(rig.as_deref());
    let learned = learned.unwrap_or_default();
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
        if coarse.frame == RefFrame::Substrate {
            let _ = writeln!(
                text,
                "marker {id}: placed relative to the substrate's marker only, nothing says where the microscope looks: not put in \
                 force. Learn the markers with a fine calibration (docs/coarse.md)"
            );
            continue;
        }
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
        let moved = moved_um(rig, number, &registration);
        let withdrawn = moved.is_some_and(|um| um > SIGMAS * registration.error_um);
        if withdrawn {
            rig.set_down(number);
        }
        let known = pipette.is_some();
        let taken = rig.set_coarse(number, registration, pipette);
        let _ = writeln!(
            text,
            "{number}: coarse registration, tip good to {}{}",
            coarse.tip_error,
            if known && !taken { "; its pipette's direction stays, it is known better" } else { "" }
        );
        if let (true, Some(um)) = (withdrawn, moved) {
            let _ = writeln!(
                text,
                "{number} stands {um:.0} µm from where its fine registration has it: it was moved by hand. That registration is out of \
                 force; bring its tip into view ('parfocal calibrate into-view') and calibrate it anew"
            );
        }
    }
    Ok(text)
}

/// A fine registration contradicted by more than this many standard deviations of the coarse one is of another day.
const SIGMAS: f64 = 4.0;

/// How far the tip is from where the fine registration has it, µm; `None` without one.
fn moved_um(rig: &Rig, number: rig::ManipulatorNumber, coarse: &CoarseRegistration) -> Option<f64> {
    let fine = Arm::of(rig, number).ok()?.ref_from_man().to_rows();
    let joints = Vector3::from(coarse.joints_um);
    let tip =
        |m: &[[f64; 4]; 4]| Vector3::from_fn(|i, _| Vector3::new(m[i][0], m[i][1], m[i][2]).dot(&joints) + m[i][3]);
    Some((tip(&coarse.matrix) - tip(&fine)).norm())
}
