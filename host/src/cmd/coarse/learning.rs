//! Learning what markers carry.

use super::super::Output;
use super::{Arguments, folder, force, placing};
use anyhow::{Context, anyhow, bail};
use nalgebra::{Matrix3, Point3, Vector3};
use parfocal::calibration::coarse::learn::fine::{self, Fine, Objective};
use parfocal::calibration::coarse::learn::{self, Click, Learned, moves};
use parfocal::calibration::coarse::{Degrees, MarkerId};
use parfocal::rig::{ManipulatorNumber, Rig};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// The file given to `--learn`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Session {
    /// The objective's marker.
    #[serde(default)]
    objective: Option<MarkerId>,
    /// Pictures, a folder for each position of the joints; folders relative to this file.
    sets: Vec<Set>,
    /// Fine calibrations by marker; without them, axes come from the moves.
    #[serde(default)]
    fine: BTreeMap<u16, FineRow>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Set {
    pairs: PathBuf,
    #[serde(default)]
    microscope_um: [f64; 3],
    manipulators: BTreeMap<u16, Stop>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stop {
    joints_um: [f64; 3],
    #[serde(default)]
    tip: Vec<Click>,
    #[serde(default)]
    shank: Vec<Click>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FineRow {
    /// The first three rows of T_man_ref, µm.
    man_to_ref_um: [[f64; 4]; 3],
    #[serde(default)]
    theta_deg: Option<f64>,
    #[serde(default)]
    psi_deg: Option<f64>,
}

pub(super) fn read<T: serde::de::DeserializeOwned>(file: &Path) -> anyhow::Result<T> {
    let text = std::fs::read_to_string(file).with_context(|| format!("{}: cannot be read", file.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{}: is not of the form in docs/coarse.md", file.display()))
}

impl Session {
    /// What is to be learned: a file that says it, or folders that `--cameras` filled, and the rig's own fine calibration.
    fn new(arguments: &Arguments, rig: Option<&Rig>) -> anyhow::Result<(Self, PathBuf)> {
        if let [file] = &arguments.learn[..]
            && !file.is_dir()
        {
            let session: Self = read(file)?;
            if session.sets.is_empty() {
                bail!("{}: names no sets of pictures", file.display());
            }
            return Ok((session, file.parent().unwrap_or(Path::new(".")).into()));
        }
        let sets = arguments.learn.iter().map(|folder| Set::of(folder)).collect::<anyhow::Result<_>>()?;
        let markers = rig.and_then(|rig| rig.contents().markers.as_ref());
        let markers =
            markers.context("folders need --rig FILE whose [markers] says which marker is on which manipulator")?;
        let fine = |(number, id): (&ManipulatorNumber, &MarkerId)| {
            let manipulator = rig?.contents().manipulators.get(number)?;
            let [a, b, c, _] = manipulator.registration.as_ref()?.matrix;
            let pipette = manipulator.pipette.as_ref();
            let (theta_deg, psi_deg) = (pipette.map(|p| p.descent_deg), pipette.map(|p| p.azimuth_deg));
            Some((id.0, FineRow { man_to_ref_um: [a, b, c], theta_deg, psi_deg }))
        };
        let fine = markers.manipulators.iter().filter_map(fine).collect();
        Ok((Self { objective: markers.objective, sets, fine }, PathBuf::new()))
    }
}

impl Set {
    /// A folder's pairs, and what lies beside them.
    fn of(folder: &Path) -> anyhow::Result<Self> {
        let now = folder::beside(folder, folder::NOW).with_context(|| {
            format!("{}: has no now.json, which says where the axes stood (docs/coarse.md)", folder.display())
        })?;
        let now: folder::NowFile = read(&now)?;
        let clicks = folder::beside(folder, folder::CLICKS).map(|file| read::<folder::Clicks>(&file)).transpose()?;
        let mut clicks = clicks.unwrap_or_default();
        let stop = |(id, joints_um)| {
            let folder::TipClicks { tip, shank } = clicks.remove(&id).unwrap_or_default();
            (id.0, Stop { joints_um, tip, shank })
        };
        let manipulators = now.joints_um.into_iter().map(stop).collect();
        Ok(Self { pairs: folder.into(), microscope_um: now.microscope_um, manipulators })
    }
}

pub(super) fn run(arguments: &Arguments, out: Output) -> anyhow::Result<()> {
    let mut rig = arguments.load_rig()?;
    let (session, folder) = Session::new(arguments, rig.as_ref())?;
    let camera = arguments.stereo(rig.as_ref())?;
    let height_um = rig.as_ref().map_or(0.0, |rig| rig.contents().objective_height_um);
    let mut stops: BTreeMap<MarkerId, Vec<moves::Stop>> = BTreeMap::new();
    let mut objective = None;
    for set in &session.sets {
        let name = set.pairs.display().to_string();
        let seen = placing::from_pairs(arguments, rig.as_ref(), &folder.join(&set.pairs))
            .with_context(|| format!("set {name}"))?;
        if let (None, Some(marker)) = (&objective, session.objective) {
            let pose = *seen.markers.get(&marker).ok_or_else(|| not_placed(marker, &name))?;
            let microscope_um = Vector3::from(set.microscope_um) + Vector3::z() * height_um;
            objective = Some(Objective { marker, pose, microscope_um });
        }
        for (id, stop) in &set.manipulators {
            let marker = MarkerId(*id);
            let pose = seen.markers.get(&marker).ok_or_else(|| not_placed(marker, &name))?;
            let point = |clicks: &[Click]| -> anyhow::Result<Option<Point3<f64>>> {
                learn::clicked(clicks, &seen.places, &camera).with_context(|| format!("set {name}, marker {id}"))
            };
            let (tip_mm, shank_mm) = (point(&stop.tip)?, point(&stop.shank)?);
            let joints_um = Vector3::from(stop.joints_um);
            let stop = moves::Stop { joints_um, marker: pose.pose, tip_mm, shank_mm };
            stops.entry(marker).or_default().push(stop);
        }
    }
    let learned = if session.fine.is_empty() {
        let one = |(id, stops): (MarkerId, Vec<moves::Stop>)| Ok((id, moves::learn(id, &stops)?));
        let manipulators = stops.into_iter().map(one).collect::<Result<_, learn::LearnError>>()?;
        Learned { manipulators, ..Learned::default() }
    } else {
        let mut all = BTreeMap::new();
        for (id, row) in &session.fine {
            let marker = MarkerId(*id);
            let seen = stops.remove(&marker);
            let seen =
                seen.ok_or_else(|| anyhow!("marker {id} has a fine calibration but is in no set: add it to one"))?;
            all.insert(marker, (row.fine(), seen));
        }
        fine::learn(&all, objective.as_ref())?
    };
    let value = serde_json::to_value(&learned)?;
    if let Some(file) = &arguments.out {
        std::fs::write(file, serde_json::to_string_pretty(&value)? + "\n")
            .with_context(|| format!("{}: cannot be written", file.display()))?;
    }
    let mut text = to_text(&learned);
    if let Some(rig) = &mut rig {
        force::keep_learned(arguments, rig, learned, session.objective)?;
        text.push_str(&arguments.save(rig)?);
    }
    out.result(&text, &value)
}

fn not_placed(marker: MarkerId, set: &str) -> learn::LearnError {
    learn::LearnError::NotPlaced { marker, set: set.into() }
}

impl FineRow {
    fn fine(&self) -> Fine {
        let m = &self.man_to_ref_um;
        Fine {
            axes: Matrix3::from_fn(|i, j| m[i][j]),
            origin_um: Vector3::from_fn(|i, _| m[i][3]),
            pipette: self.theta_deg.zip(self.psi_deg).map(|(t, p)| [Degrees(t), Degrees(p)]),
        }
    }
}

fn to_text(learned: &Learned) -> String {
    let mut text = String::new();
    for (id, m) in &learned.manipulators {
        let scale: Vec<String> = (0..3).map(|k| format!("{:.3}", m.axes.column(k).norm())).collect();
        let _ = write!(text, "marker {id}: axes' scales {}", scale.join(" "));
        if let Some(tip) = m.tip_mm {
            let _ = write!(text, ", tip at {:.2} {:.2} {:.2} mm", tip.x, tip.y, tip.z);
        }
        let _ = writeln!(text, "{}", if m.rides { "" } else { ", on the base" });
    }
    for (id, o) in &learned.objectives {
        let t = o.mic.translation.vector;
        let _ = writeln!(text, "marker {id}: focal point at {:.2} {:.2} {:.2} mm", t.x, t.y, t.z);
    }
    text
}
