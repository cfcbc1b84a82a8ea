//! `parfocal status`: where the axes are.

use super::connection::{Connection, Purpose};
use super::{Output, simulated};
use parfocal::link::explain::Explained;
use parfocal::stage::status;
use parfocal_protocol::message::Trust;
use serde::Serialize;

/// Say where the axes are and what they are doing
#[derive(Debug, clap::Args)]
pub struct Arguments {}

#[derive(Serialize)]
struct Row {
    axis: String,
    position_um: f64,
    steps: i32,
    trust: &'static str,
    moving: bool,
    enabled: bool,
    at_low_switch: bool,
    at_high_switch: bool,
}

/// What a position is worth, in words.
fn trust(trust: Trust) -> &'static str {
    match trust {
        Trust::Unknown => "counted from power-on",
        Trust::Known => "known",
        Trust::Restored => "kept over power-off",
        Trust::RestoredRoughly => "kept over power-off, ± 2 full steps",
        Trust::Lost => "not to be trusted: home it",
    }
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When a board does not answer.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let mut bench = connection.open(Purpose::Look, model)?;
        let places: Vec<_> = bench.stage.axes().collect();
        let statuses = bench.stage.boards_mut().iter_mut().map(status).collect::<Result<Vec<_>, _>>()?;
        let rows: Vec<Row> = places
            .into_iter()
            .filter_map(|(name, place)| {
                let axis = statuses.get(place.board)?.axes.get(place.axis.index()?)?;
                Some(Row {
                    axis: name.to_string(),
                    position_um: axis.position.micrometres().0,
                    steps: axis.steps.0,
                    trust: trust(axis.trust),
                    moving: axis.moving,
                    enabled: axis.enabled,
                    at_low_switch: axis.at_low,
                    at_high_switch: axis.at_high,
                })
            })
            .collect();
        bench.stage.close();
        let mut text = rows.iter().map(line).collect::<Vec<_>>().join("\n");
        let emergency = statuses.iter().any(|s| s.emergency);
        if emergency {
            text += "\nthe emergency stop is in force: release it, then `parfocal stop --clear`";
        }
        let stopped: Vec<String> =
            statuses.iter().filter_map(|s| s.stopped).map(|cause| Explained(&cause).to_string()).collect();
        for cause in &stopped {
            text += &format!("\nthe last motion ended early: {cause}");
        }
        out.result(&text, &serde_json::json!({ "axes": rows, "emergency": emergency, "stopped": stopped }))
    }
}

fn line(row: &Row) -> String {
    let mut notes = vec![row.trust];
    notes.extend(row.moving.then_some("moving"));
    notes.extend((!row.enabled).then_some("current off"));
    notes.extend(row.at_low_switch.then_some("at the low switch"));
    notes.extend(row.at_high_switch.then_some("at the high switch"));
    format!("{:<8} {:>12.3} µm   {}", row.axis, row.position_um, notes.join(", "))
}
