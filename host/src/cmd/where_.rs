//! `parfocal where`: every tip in ref and in the picture.

use super::connection::{Bench, Connection, Purpose};
use super::{Output, interrupt, simulated};
use parfocal::procedure::{Guard, TipPlace, tips};

/// Say where every tip is, in ref and in the picture
#[derive(Debug, clap::Args)]
pub struct Arguments {}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When a board does not answer, or the rig's file is wrong.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let rig = super::guarded::rig_file(connection)?;
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let Bench { mut stage, .. } = connection.open(Purpose::Look, model)?;
        let pose = Guard::new(&mut stage, &rig, &interrupt::keep_on).pose();
        stage.close();
        let pose = pose?;
        let places = tips(&rig, &pose);
        let microscope = pose.microscope(&rig);
        let contents = rig.contents();
        let objective = contents.objective_in_use.as_deref();
        let mut text = format!(
            "microscope at ({:.2}, {:.2}, {:.2}) µm, objective {}\n",
            microscope.x,
            microscope.y,
            microscope.z,
            objective.unwrap_or("not known: say it with 'parfocal objective NAME'")
        );
        text += &places.iter().map(line).collect::<Vec<_>>().join("\n");
        let json = serde_json::json!({
            "microscope_um": [microscope.x, microscope.y, microscope.z],
            "objective": objective,
            "tips": places,
        });
        out.result(&text, &json)
    }
}

fn line(tip: &TipPlace) -> String {
    let mut text = format!("{}  ", tip.manipulator);
    if let Some([x, y, z]) = tip.ref_um {
        text += &format!("tip at ({x:.2}, {y:.2}, {z:.2}) µm of ref");
        if let Some(error) = tip.error_um {
            text += &format!(" ± {error:.2}{}", if tip.coarse { " by its marker alone" } else { "" });
        }
    }
    if let (Some([x, y]), Some(above)) = (tip.pixel, tip.above_focus_um) {
        let place = if tip.in_view { "in the picture" } else { "outside the picture" };
        let side = if above >= 0.0 { "above" } else { "below" };
        text += &format!(", {place} at ({x:.1}, {y:.1}) px, {:.2} µm {side} focus", above.abs());
    }
    if let Some(why) = &tip.why {
        text += &format!("{}{why}", if tip.ref_um.is_some() { "; " } else { "" });
    }
    text
}
