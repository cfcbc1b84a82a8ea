//! `parfocal ports`: where boards are.

use super::Output;
use super::connection::{connect, fresh_session, hex};
use parfocal::link::serial::ports;
use parfocal_protocol::message::{Role, Session};
use serde::Serialize;

/// List the ports of this computer and the boards on them
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Also ask ports that do not look like a board's
    #[arg(long)]
    all: bool,
}

#[derive(Serialize)]
struct Row {
    port: String,
    description: String,
    board: Option<String>,
    unique_id: Option<String>,
    problem: Option<String>,
    same_board_as: Option<String>,
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// When the system will not list its ports.
    pub fn run(self, out: Output) -> anyhow::Result<()> {
        let mut rows: Vec<Row> = Vec::new();
        for port in ports()? {
            let mut row = Row {
                port: port.name.clone(),
                description: port.description,
                board: None,
                unique_id: None,
                problem: None,
                same_board_as: None,
            };
            // Asking sends bytes, which other devices may not like: only likely ones unless told to.
            if port.likely || self.all {
                match connect(&port.name, Session(fresh_session()), Role::Watch) {
                    Ok(link) => {
                        let id = hex(&link.hello().unique_id);
                        row.same_board_as =
                            rows.iter().find(|r| r.unique_id.as_ref() == Some(&id)).map(|r| r.port.clone());
                        row.board = Some(link.hello().board.as_str().into());
                        row.unique_id = Some(id);
                        link.close();
                    }
                    Err(error) => row.problem = Some(error.to_string()),
                }
            }
            rows.push(row);
        }
        let text = if rows.is_empty() {
            "no serial ports: plug a board in, or work on the simulated rig (no --port)".into()
        } else {
            rows.iter().map(line).collect::<Vec<_>>().join("\n")
        };
        out.result(&text, &serde_json::json!({ "ports": rows }))
    }
}

fn line(row: &Row) -> String {
    let what = match (&row.board, &row.same_board_as, &row.problem) {
        (_, Some(other), _) => format!("the board that is on {other} too"),
        (Some(board), None, _) => format!("{board} {}", row.unique_id.as_deref().unwrap_or("")),
        (None, None, Some(problem)) => problem.clone(),
        (None, None, None) => "not asked (--all asks)".into(),
    };
    format!("{:<20} {:<40} {what}", row.port, row.description)
}
