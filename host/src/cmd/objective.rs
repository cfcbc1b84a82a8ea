//! `parfocal objective`: which objective is in the light path.

use super::Output;
use super::connection::Connection;
use anyhow::{Context, bail};
use parfocal::rig::{Objective, Rig, Zoom};

/// Say which objective is in the light path: a wrong one breaks pipettes
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Its name; without one: which it is, and which there are
    name: Option<String>,
    /// Add it to the rig's file; the first one becomes the default, the one with α = 1
    #[arg(long, requires = "name")]
    new: bool,
    /// Nobody knows which it is: what could break a pipette refuses from now on
    #[arg(long, conflicts_with_all = ["name", "new"])]
    unknown: bool,
    /// The microscope's zoom (its own magnification changer)
    #[arg(long, value_name = "FACTOR", value_parser = super::calibrate::positive)]
    zoom: Option<f64>,
    /// Its depth of field, µm: what autofocus counts its probes in
    #[arg(long, value_name = "UM", value_parser = super::calibrate::positive, requires = "name")]
    depth_of_field_um: Option<f64>,
    /// How many times larger its pixel is than the default objective's, as engraved (10 for 4x beside 40x): good enough to look for
    /// a tip with, until 'calibrate objective' measures it
    #[arg(long, value_name = "FACTOR", value_parser = super::calibrate::positive, requires = "new")]
    alpha: Option<f64>,
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// A name that is not in the rig's file, or a turret that has no such objective.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let path = connection.rig.as_deref().context("give --rig FILE: it keeps which objective is in use")?;
        let mut rig = Rig::load(path).with_context(|| path.display().to_string())?;
        if let Some(name) = &self.name {
            if self.new {
                if rig.contents().objectives.contains_key(name) {
                    bail!("objective '{name}' is in {} already: leave --new away", path.display());
                }
                let default = rig.contents().objectives.is_empty();
                rig.contents_mut().objectives.insert(name.clone(), Objective { default, ..Objective::default() });
                if let Some(alpha) = self.alpha {
                    let zoom = self.zoom.or(rig.contents().zoom_in_use).unwrap_or(1.0);
                    rig.set_zoom(name, Zoom { zoom, alpha, kappa_um: [0.0; 3], record: None });
                }
            }
            rig.set_objective_in_use(Some(name)).context("--new adds an objective")?;
            if let (Some(depth), Some(objective)) =
                (self.depth_of_field_um, rig.contents_mut().objectives.get_mut(name))
            {
                objective.depth_of_field_um = Some(depth);
            }
            if connection.is_simulated() {
                let model = super::simulated::Model { seed: connection.seed, ..Default::default() };
                if let Some(simulated) = connection.simulated(model)? {
                    simulated.set_objective(name).map_err(anyhow::Error::msg)?;
                }
            }
        }
        if self.unknown {
            rig.set_objective_in_use(None)?;
        }
        if let Some(zoom) = self.zoom {
            rig.contents_mut().zoom_in_use = Some(zoom);
        }
        if self.name.is_some() || self.unknown || self.zoom.is_some() {
            rig.save(path)?;
        }
        let contents = rig.contents();
        let zoom = contents.zoom_in_use.unwrap_or(1.0);
        let mut text = match &contents.objective_in_use {
            Some(name) => format!("objective {name} is in use, zoom {zoom}\n"),
            None => "which objective is in use is not known\n".into(),
        };
        let mut rows = serde_json::Map::new();
        for (name, objective) in &contents.objectives {
            let entry = objective.zooms.iter().find(|z| z.zoom == zoom);
            let (alpha, kappa) = match entry {
                Some(entry) => (Some(entry.alpha), Some(entry.kappa_um)),
                None if objective.default && zoom == 1.0 => (Some(1.0), Some([0.0; 3])),
                None => (None, None),
            };
            text += &match (alpha, kappa) {
                (Some(alpha), Some([x, y, z])) => {
                    let default = if objective.default { " (default)" } else { "" };
                    format!("  {name}{default}: alpha {alpha:.4}, kappa ({x:.2}, {y:.2}, {z:.2}) µm\n")
                }
                _ => format!("  {name}: not calibrated at zoom {zoom}: 'parfocal calibrate objective'\n"),
            };
            rows.insert(
                name.clone(),
                serde_json::json!({ "alpha": alpha, "kappa_um": kappa, "default": objective.default }),
            );
        }
        let json = serde_json::json!({ "in_use": contents.objective_in_use, "zoom": zoom, "objectives": rows });
        out.result(&text, &json)
    }
}
