//! What lies beside a folder's pairs: where the axes stood (`now.json`), and clicks on tips (`clicks.json`).

use anyhow::Context;
use nalgebra::Vector3;
use parfocal::calibration::coarse::MarkerId;
use parfocal::calibration::coarse::learn::{Click, Now};
use parfocal::procedure::Guard;
use parfocal::rig::Rig;
use parfocal::stage::Stage;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The names of the two.
pub(super) const NOW: &str = "now.json";
pub(super) const CLICKS: &str = "clicks.json";

/// Where everything motorised stood, by its axes.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NowFile {
    #[serde(default)]
    pub microscope_um: [f64; 3],
    /// By marker.
    #[serde(default)]
    pub joints_um: BTreeMap<MarkerId, [f64; 3]>,
}

/// Clicks on a pipette.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TipClicks {
    #[serde(default)]
    pub tip: Vec<Click>,
    #[serde(default)]
    pub shank: Vec<Click>,
}

/// Clicks by marker.
pub(super) type Clicks = BTreeMap<MarkerId, TipClicks>;

impl NowFile {
    /// Where a rig's axes stand now; none for a rig without markers on its manipulators.
    pub(super) fn of(stage: &mut Stage, rig: &Rig) -> anyhow::Result<Self> {
        let pose = Guard::new(stage, rig, &|| true).pose()?;
        let markers = rig.contents().markers.iter().flat_map(|m| &m.manipulators);
        let joints_um = markers.map(|(number, id)| (*id, pose.joints(*number).coordinates.into())).collect();
        Ok(Self { microscope_um: pose.microscope(rig).into(), joints_um })
    }

    /// As learning and placing take it. Ref stays where it is when the coarse focus knob lifts the objective and its marker.
    pub(super) fn now(self, rig: Option<&Rig>) -> Now {
        let height_um = rig.map_or(0.0, |rig| rig.contents().objective_height_um);
        Now {
            microscope_um: Vector3::from(self.microscope_um) + Vector3::z() * height_um,
            joints_um: self.joints_um.into_iter().map(|(id, j)| (id, Vector3::from(j))).collect(),
        }
    }
}

/// Writes one of the two.
pub(super) fn write<T: Serialize>(folder: &Path, name: &str, value: &T) -> anyhow::Result<()> {
    let path = folder.join(name);
    std::fs::write(&path, serde_json::to_string_pretty(value)? + "\n")
        .with_context(|| format!("{}: cannot be written", path.display()))
}

/// One of the two, if it is there.
pub(super) fn beside(folder: &Path, name: &str) -> Option<PathBuf> {
    Some(folder.join(name)).filter(|path| path.exists())
}
