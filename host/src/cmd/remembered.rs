//! The simulated rig's memory: where its axes were left, so that one command goes on where the last one ended, as on a
//! real rig. It is kept beside the rig's file.

use anyhow::{Context, bail};
use parfocal::rig::{Axis, AxisName, Device, Moves, Objective, Rig};
use parfocal_protocol::units::Micrometres;
use parfocal_simulator::model::RigModel;
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
        let table: BTreeMap<String, f64> = toml::from_str(&text)
            .with_context(|| format!("{path} is not what the simulated rig left there: delete it"))?;
        let mut positions = BTreeMap::new();
        for (name, um) in table {
            let axis: AxisName = name.parse().with_context(|| format!("{path}: {name}"))?;
            if !um.is_finite() || um.abs() > 1e6 {
                bail!("{path}: {name} = {um} is no position of the simulated rig: correct it, or delete the file");
            }
            positions.insert(axis, Micrometres(um));
        }
        Ok(Remembered { positions })
    }

    /// Keeps where everything is.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn keep(&self, left: &Remembered) -> anyhow::Result<()> {
        let lines: String = left.positions.iter().map(|(name, at)| format!("\"{name}\" = {:?}\n", at.0)).collect();
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
    Ok(Remembered { positions: BTreeMap::from([("m2.x".parse()?, Micrometres(-400.0))]) })
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
    Ok(rig)
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
        let left = Remembered { positions: BTreeMap::from([(axis, Micrometres(-12.0625))]) };
        memory.keep(&left).unwrap();
        assert_eq!(memory.recall().unwrap(), left);
        for (text, says) in [("m1.z", "delete it"), ("\"m1.w\" = 1.0", "m1.w"), ("\"m1.z\" = nan", "m1.z = NaN")] {
            std::fs::write(folder.path().join("rig.simulated.toml"), text).unwrap();
            let error = format!("{:#}", memory.recall().unwrap_err());
            assert!(error.contains("rig.simulated.toml") && error.contains(says), "{error}");
        }
    }
}
