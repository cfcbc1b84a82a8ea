//! `parfocal calibrate objective-height`: the objective's height after a turn of the coarse focus knob.

use super::super::Output;
use anyhow::{Context, anyhow, bail};
use clap::{ArgGroup, Args};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use parfocal::calibration::coarse::objective::{from_tip, from_view};
use parfocal::calibration::coarse::{Degrees, MarkerPose, Millimetres};
use parfocal::rig::Rig;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// The objective's height after a turn of the coarse focus knob: from one focused tip, or from the coarse view before and after
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("from").required(true).args(["focused_um", "after"])))]
pub struct Arguments {
    /// Height at which the tip is in focus now by the old calibration, in ref
    #[arg(long, value_name = "UM", requires = "expected_um", allow_hyphen_values = true)]
    focused_um: Option<f64>,
    /// The tip's height by its manipulator's registration, in ref
    #[arg(long, value_name = "UM", allow_hyphen_values = true)]
    expected_um: Option<f64>,
    /// Standard error of the focus
    #[arg(long, value_name = "UM", default_value_t = 1.0)]
    error_um: f64,
    /// What `calibrate coarse --json` gave before the knob was turned
    #[arg(long, value_name = "FILE")]
    before: Option<PathBuf>,
    /// What `calibrate coarse --json` gave after
    #[arg(long, value_name = "FILE", requires_all = ["before", "marker"])]
    after: Option<PathBuf>,
    /// The objective's marker
    #[arg(long, value_name = "ID")]
    marker: Option<u16>,
    /// The rig, in whose file the new height is put in force
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Leave the rig's file as it is
    #[arg(long)]
    dry_run: bool,
    /// By how much the motors moved the objective in between, in ref: x,y,z
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,0", value_parser = three, allow_hyphen_values = true)]
    motors_um: Three,
}

/// Three lengths, µm.
#[derive(Clone, Copy, Debug)]
struct Three(Vector3<f64>);

fn three(text: &str) -> Result<Three, String> {
    let parts: Result<Vec<f64>, _> = text.split(',').map(|p| p.trim().parse::<f64>()).collect();
    match parts.as_deref() {
        Ok([x, y, z]) if [x, y, z].iter().all(|v| v.is_finite()) => Ok(Three(Vector3::new(*x, *y, *z))),
        _ => Err(format!("'{text}' is no move: write x,y,z in µm, as in 0,0,250")),
    }
}

/// Runs `parfocal calibrate objective-height`.
///
/// # Errors
/// Missing files or markers, and pictures that show something else than a turn of the focus knob.
pub fn run(arguments: &Arguments, out: Output) -> anyhow::Result<()> {
    let change = match (arguments.focused_um, arguments.expected_um) {
        (Some(focused), Some(expected)) => from_tip(expected, focused, arguments.error_um)?,
        _ => {
            let (Some(before), Some(after), Some(id)) = (&arguments.before, &arguments.after, arguments.marker) else {
                bail!("give --focused-um with --expected-um, or --before, --after and --marker");
            };
            let (before, after) = (marker(before, id)?, marker(after, id)?);
            // The substrate's marker lies on the table, its z into the paper; ref's z is up.
            let over = Rotation3::from_matrix_unchecked(Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)));
            let over = Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_rotation_matrix(&over));
            from_view(&before, &after, arguments.motors_um.0, &over)?
        }
    };
    let mut text =
        format!("the objective stands {:+.1} µm higher than calibrated (± {:.1} µm)\n", change.z_um, change.error_um);
    let mut value = serde_json::json!(change);
    if let Some(path) = &arguments.rig {
        let mut rig = Rig::load(path)?;
        rig.shift_focus(change.z_um);
        let height_um = rig.contents().objective_height_um;
        value["objective_height_um"] = height_um.into();
        if arguments.dry_run {
            let _ = writeln!(text, "{} stays as it was (--dry-run).", path.display());
        } else {
            rig.save(path)?;
            let _ = writeln!(
                text,
                "In force in {}: objective_height_um = {height_um:.1}; all else stands.",
                path.display()
            );
        }
    }
    out.result(&text, &value)
}

/// What of `calibrate coarse --json` is needed.
#[derive(Deserialize)]
struct Registered {
    markers: BTreeMap<u16, [[f64; 4]; 4]>,
    uncertainty: BTreeMap<u16, Uncertainty>,
}

#[derive(Clone, Copy, Deserialize)]
struct Uncertainty {
    mm: f64,
    deg: f64,
}

fn marker(file: &Path, id: u16) -> anyhow::Result<MarkerPose> {
    let text = std::fs::read_to_string(file).with_context(|| format!("{}: cannot be read", file.display()))?;
    let all: Registered = serde_json::from_str(&text)
        .with_context(|| format!("{}: is not what calibrate coarse --json gives", file.display()))?;
    let missing = || anyhow!("{}: marker {id} was not placed; photograph the objective's marker", file.display());
    let m = all.markers.get(&id).ok_or_else(missing)?;
    let error = all.uncertainty.get(&id).copied().ok_or_else(missing)?;
    let turn = Rotation3::from_matrix(&Matrix3::from_fn(|i, j| m[i][j]));
    let at = Translation3::new(m[0][3], m[1][3], m[2][3]);
    let pose = Isometry3::from_parts(at, UnitQuaternion::from_rotation_matrix(&turn));
    Ok(MarkerPose { pose, position: Millimetres(error.mm), orientation: Degrees(error.deg) })
}
