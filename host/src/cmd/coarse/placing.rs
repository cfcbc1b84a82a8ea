//! Markers placed relative to the substrate's, from pictures or from another tracker's poses.

use super::super::{Connection, Output};
use super::{Arguments, cameras, force, pairs};
use anyhow::{Context, bail};
use parfocal::calibration::coarse::poses::{self, Tracker};
use parfocal::calibration::coarse::{Degrees, MarkerId, Millimetres, Registration, Settings, graph, register};
use parfocal::rig::Rig;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;

/// Reads `3=12.5`.
pub(super) fn id_and_size(text: &str) -> Result<(u16, f64), String> {
    let parts = text.split_once('=').and_then(|(id, mm)| Some((id.trim().parse().ok()?, mm.trim().parse().ok()?)));
    parts.ok_or_else(|| format!("'{text}' is no marker's size: write ID=MM, as in 3=12.5"))
}

pub(super) fn settings(a: &Arguments, rig: Option<&Rig>) -> Settings {
    Settings {
        tag_mm_of: a.tag_mm_of.iter().map(|(id, mm)| (MarkerId(*id), *mm)).collect(),
        gamma: a.gamma,
        ..Settings::new(a.tag_mm(rig), a.substrate(rig))
    }
}

/// Registers the pairs of a folder.
pub(super) fn from_pairs(arguments: &Arguments, rig: Option<&Rig>, folder: &Path) -> anyhow::Result<Registration> {
    let camera = arguments.stereo(rig)?;
    let pairs = pairs::read(folder)?;
    if pairs.len() < 2 {
        eprintln!(
            "one place only: markers hidden there are missed, and nothing shows a wrong pose; two places are better"
        );
    }
    Ok(register(&pairs, &camera, &settings(arguments, rig))?)
}

pub(super) fn run(arguments: &Arguments, connection: &Connection, out: Output) -> anyhow::Result<()> {
    let mut rig = arguments.load_rig()?;
    if let (false, Some(folder)) = (arguments.cameras.is_empty(), &arguments.pairs) {
        cameras::take(arguments, folder, rig.as_ref(), connection)?;
    }
    let found = match (&arguments.pairs, &arguments.poses) {
        (Some(folder), _) => from_pairs(arguments, rig.as_ref(), folder)?,
        (None, Some(file)) => {
            let text = std::fs::read_to_string(file).with_context(|| format!("{}: cannot be read", file.display()))?;
            let (position, orientation) = (Millimetres(arguments.tracker_mm), Degrees(arguments.tracker_deg));
            if !(position.0 > 0.0 && orientation.0 > 0.0) {
                bail!("--tracker-mm and --tracker-deg are standard deviations: give numbers above 0");
            }
            let views = poses::read(&text, Tracker { position, orientation });
            let views = views.with_context(|| format!("{}", file.display()))?;
            graph::solve(&views, arguments.substrate(rig.as_ref()))?
        }
        (None, None) => bail!("nothing to register: give --pairs or --poses"),
    };
    for left_out in &found.rejected {
        eprintln!("{left_out}");
    }
    for id in &found.unconnected {
        eprintln!(
            "marker {id}: never seen together with the substrate's marker {}, nor with one that was; photograph them together",
            found.substrate
        );
    }
    let mut value = to_json(&found);
    let mut text = to_text(&found);
    force::place(arguments, &found, rig.as_mut(), &mut value, &mut text)?;
    if let Some(file) = &arguments.out {
        std::fs::write(file, serde_json::to_string(&value)? + "\n")
            .with_context(|| format!("{}: cannot be written", file.display()))?;
    }
    out.result(&text, &value)
}

/// `{"markers": …, "uncertainty": …, "rejected": […], "unconnected": […]}`, marker → substrate marker, mm.
pub(super) fn to_json(found: &Registration) -> Value {
    let rows = |f: &dyn Fn(&parfocal::calibration::coarse::MarkerPose) -> Value| -> serde_json::Map<String, Value> {
        found.markers.iter().map(|(id, m)| (id.to_string(), f(m))).collect()
    };
    json!({
        "substrate": found.substrate,
        "markers": rows(&|m| json!(m.matrix())),
        "uncertainty": rows(&|m| json!({ "mm": m.position, "deg": m.orientation })),
        "rejected": found.rejected,
        "unconnected": found.unconnected,
        "places": found.places.keys().collect::<Vec<_>>(),
    })
}

fn to_text(found: &Registration) -> String {
    let mut text = format!("relative to marker {}, mm:\n", found.substrate);
    for (id, m) in &found.markers {
        let t = m.pose.translation.vector;
        let _ =
            writeln!(text, "marker {id}: {:9.3} {:9.3} {:9.3}   ± {}, {}", t.x, t.y, t.z, m.position, m.orientation);
    }
    text
}
