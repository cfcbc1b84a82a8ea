//! The simulated rig's memory: where its axes were left and its manipulators set down, so that one command goes on where the
//! last one ended, as on a real rig. It is kept beside the rig's file.

use anyhow::{Context, bail};
use parfocal::calibration::coarse::{MarkerId, StereoCamera};
use parfocal::rig::{Axis, AxisName, Device, ManipulatorNumber, Markers, Moves, Objective, Rig};
use parfocal_protocol::units::Micrometres;
use parfocal_simulator::model::RigModel;
use parfocal_simulator::stereo::bench;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Where it is kept.
#[derive(Clone, Debug)]
pub struct Memory(PathBuf);

/// What is kept.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Remembered {
    /// Where every axis was left.
    pub positions: BTreeMap<AxisName, Micrometres>,
    /// How far a hand has set manipulators down from where they were built in, in ref, µm.
    pub set_down: BTreeMap<ManipulatorNumber, [f64; 3]>,
}

/// A line of the file.
#[derive(Debug, serde::Deserialize)]
#[serde(untagged)]
enum Entry {
    Axis(f64),
    SetDown([f64; 3]),
}

/// The first line of the file.
const ABOUT: &str = "# Where the simulated rig's axes were left, in µm. Delete this file to switch it on anew.\n";

impl Memory {
    /// The memory of the simulated rig that a rig file describes.
    pub fn beside(rig: &Path) -> Self {
        Self(rig.with_extension("simulated.toml"))
    }

    /// What was kept; nothing if the file is not there.
    ///
    /// # Errors
    /// A file that is none of ours, with what is wrong.
    pub fn recall(&self) -> anyhow::Result<Remembered> {
        let path = self.0.display();
        let text = match std::fs::read_to_string(&self.0) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Remembered::default()),
            Err(e) => return Err(e).with_context(|| format!("cannot read {path}")),
        };
        let table: BTreeMap<String, Entry> = toml::from_str(&text)
            .with_context(|| format!("{path} is not what the simulated rig left there: delete it"))?;
        let mut left = Remembered::default();
        let checked = |name: &str, um: f64| {
            if !um.is_finite() || um.abs() > 1e6 {
                bail!("{path}: {name} = {um} is no position of the simulated rig: correct it, or delete the file");
            }
            Ok(um)
        };
        for (name, entry) in table {
            match entry {
                Entry::Axis(um) => {
                    let axis: AxisName = name.parse().with_context(|| format!("{path}: {name}"))?;
                    left.positions.insert(axis, Micrometres(checked(&name, um)?));
                }
                Entry::SetDown(by) => {
                    let number: ManipulatorNumber = name.parse().with_context(|| format!("{path}: {name}"))?;
                    by.into_iter().try_for_each(|um| checked(&name, um).map(drop))?;
                    left.set_down.insert(number, by);
                }
            }
        }
        Ok(left)
    }

    /// Keeps where everything is.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn keep(&self, left: &Remembered) -> anyhow::Result<()> {
        let axes = left.positions.iter().map(|(name, at)| format!("\"{name}\" = {:?}\n", at.0));
        let set_down = left.set_down.iter().map(|(number, by)| format!("{number} = {by:?} # set down by hand\n"));
        let lines: String = axes.chain(set_down).collect();
        std::fs::write(&self.0, format!("{ABOUT}{lines}"))
            .with_context(|| format!("cannot write {}, where the simulated rig's axes were left", self.0.display()))
    }
}

/// The simulated rig ready to be calibrated: the second manipulator's pipette withdrawn out of view, so that one tip is
/// in the picture.
///
/// # Errors
/// Never: its names are names.
pub fn parked() -> anyhow::Result<Remembered> {
    Ok(Remembered { positions: BTreeMap::from([("m2.x".parse()?, Micrometres(-400.0))]), ..Remembered::default() })
}

/// The simulated rig's file, nothing calibrated.
///
/// # Errors
/// Never: its names are names.
pub fn simulated_rig_file() -> anyhow::Result<Rig> {
    let model = RigModel::new(0);
    let mut rig = Rig::new();
    for (name, place) in super::simulated::axes() {
        let board = name.device.to_string();
        let mut id = *b"PF-sim-boar1";
        id[11] = b'1' + place.board as u8;
        rig.set_board(&board, super::connection::hex(&id).parse()?);
        let moves = (name.device == Device::Scope).then_some(Moves::Objective);
        rig.set_axis(name, Axis { board, index: place.axis.0, moves });
    }
    let (width_px, height_px) = (model.camera.width as u32, model.camera.height as u32);
    rig.contents_mut().camera = Some(toml::from_str(&format!("width_px = {width_px}\nheight_px = {height_px}"))?);
    for (i, objective) in model.objectives.iter().enumerate() {
        let depth_of_field_um = Some(objective.depth_of_field_um);
        let entry = Objective { default: i == 0, depth_of_field_um, zooms: Vec::new() };
        rig.contents_mut().objectives.insert(objective.name.into(), entry);
    }
    rig.contents_mut().objective_in_use = model.objectives.first().map(|o| o.name.into());
    let manipulators = super::simulated::manipulators().zip(1..).map(|(number, id)| (number, MarkerId(id))).collect();
    let objective = Some(MarkerId(model.manipulators.len() as u16 + 1));
    let (tag_mm, substrate) = (bench::TAG_MM, MarkerId(bench::SUBSTRATE));
    rig.contents_mut().markers = Some(Markers { tag_mm, substrate, objective, manipulators, learned: None });
    rig.contents_mut().stereo = Some(stereo_camera()?);
    Ok(rig)
}

/// The simulated rig's stereo camera.
fn stereo_camera() -> anyhow::Result<StereoCamera> {
    let pair = bench::Pair::new();
    let [left, right] = pair.lenses.map(|lens| {
        let [k1, k2, p1, p2] = lens.distortion;
        serde_json::json!({
            "fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy, "k1": k1, "k2": k2, "p1": p1, "p2": p2,
        })
    });
    let file = serde_json::json!({
        "image_size": [pair.size.0, pair.size.1], "left": left, "right": right,
        "R": pair.left_to_right.rotation, "t_m": pair.left_to_right.translation.map(|mm| mm / 1000.0),
    });
    Ok(StereoCamera::from_json(&file.to_string())?)
}

/// Whether all of a rig's boards are the simulated ones.
pub fn is_of_simulated_rig(rig: &Rig) -> bool {
    let boards = &rig.contents().boards;
    let prefix = super::connection::hex(b"PF-sim-boar");
    !boards.is_empty() && boards.values().all(|board| board.unique_id.as_str().starts_with(&prefix))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_recalled_and_nonsense_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let memory = Memory::beside(&folder.path().join("rig.toml"));
        assert_eq!(memory.recall().unwrap(), Remembered::default());
        let axis: AxisName = "m1.z".parse().unwrap();
        let left = Remembered {
            positions: BTreeMap::from([(axis, Micrometres(-12.0625))]),
            set_down: BTreeMap::from([(ManipulatorNumber::new(2).unwrap(), [900.0, -0.5, 0.0])]),
        };
        memory.keep(&left).unwrap();
        assert_eq!(memory.recall().unwrap(), left);
        for (text, says) in [("m1.z", "delete it"), ("\"m1.w\" = 1.0", "m1.w"), ("\"m1.z\" = nan", "m1.z = NaN")] {
            std::fs::write(folder.path().join("rig.simulated.toml"), text).unwrap();
            let error = format!("{:#}", memory.recall().unwrap_err());
            assert!(error.contains("rig.simulated.toml") && error.contains(says), "{error}");
        }
    }
}
