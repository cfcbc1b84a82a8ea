//! `parfocal settings get|set|save|export|import`: what the boards know of their axes.

use super::connection::{Bench, Connection, Purpose, hex, shown};
use super::{Output, simulated};
use anyhow::{Context, bail};
use parfocal::rig::AxisName;
use parfocal::settings::{AxisText, BoardText, SettingsFile, with_key};
use parfocal_protocol::message::{Request, Response};
use std::path::PathBuf;

/// Read and change what the boards know of their axes
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Show the settings of all axes, or of one, or one of its keys
    Get {
        /// As in scope.z
        axis: Option<AxisName>,
        /// As in speed_um_s
        key: Option<String>,
    },
    /// Change settings of an axis: `set scope.z speed_um_s=500`; kept over a power cycle by `save`
    Set {
        /// As in scope.z; `board` for the board's own
        axis: String,
        /// KEY=VALUE
        #[arg(required = true, allow_hyphen_values = true)]
        changes: Vec<String>,
        /// Keep them over a power cycle, too
        #[arg(long)]
        save: bool,
    },
    /// Keep the present settings over a power cycle
    Save,
    /// Write all settings to a TOML file
    Export {
        /// The file
        file: PathBuf,
    },
    /// Take settings from a TOML file: all of them, or none if one is refused
    Import {
        /// The file
        file: PathBuf,
        /// Keep them over a power cycle, too
        #[arg(long)]
        save: bool,
    },
}

/// Version of the exported file's keys.
const SCHEMA: u32 = 1;

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// Names the axis, the key and the allowed range of what was refused.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        let looks = matches!(self.what, What::Get { .. } | What::Export { .. });
        let purpose = if looks { Purpose::Look } else { Purpose::Control };
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let mut bench = connection.open(purpose, model)?;
        let done = carry_out(&mut bench, self.what, out);
        bench.stage.close();
        done
    }
}

fn carry_out(bench: &mut Bench, what: What, out: Output) -> anyhow::Result<()> {
    match what {
        What::Get { axis: None, .. } => {
            let file = read(bench)?;
            out.result(&toml::to_string(&file)?, &file)
        }
        What::Get { axis: Some(axis), key } => {
            let text = AxisText::from(bench.stage.settings(axis)?);
            let Some(key) = key else { return out.result(&toml::to_string(&text)?, &text) };
            let table = toml::Table::try_from(&text)?;
            let value = table.get(&key).with_context(|| format!("there is no setting '{key}'"))?;
            out.result(&value.to_string(), &serde_json::json!({ key: value }))
        }
        What::Set { axis, changes, save: keep } => {
            if axis == "board" {
                set_boards(bench, &changes)?;
            } else {
                set_axis(bench, axis.parse()?, &changes)?;
            }
            if keep {
                save(bench)?;
            }
            out.result("set", &serde_json::json!({ "set": changes, "saved": keep }))
        }
        What::Save => {
            save(bench)?;
            out.result("kept over a power cycle", &serde_json::json!({ "saved": true }))
        }
        What::Export { file } => {
            let text = toml::to_string(&read(bench)?)?;
            std::fs::write(&file, text).with_context(|| format!("{}: cannot be written", shown(&file)))?;
            out.result(&format!("written to {}", shown(&file)), &serde_json::json!({ "file": shown(&file) }))
        }
        What::Import { file, save: keep } => {
            let text = std::fs::read_to_string(&file).with_context(|| format!("{}: cannot be read", shown(&file)))?;
            let settings: SettingsFile = toml::from_str(&text).with_context(|| shown(&file))?;
            import(bench, settings).with_context(|| shown(&file))?;
            if keep {
                save(bench)?;
            }
            out.result("imported", &serde_json::json!({ "file": shown(&file), "saved": keep }))
        }
    }
}

fn read(bench: &mut Bench) -> anyhow::Result<SettingsFile> {
    let mut file = SettingsFile { schema: SCHEMA, ..Default::default() };
    let names: Vec<AxisName> = bench.stage.axes().map(|(name, _)| name).collect();
    for name in names {
        file.axes.insert(name.to_string(), bench.stage.settings(name)?.into());
    }
    for link in bench.stage.boards_mut() {
        if let Response::Board(settings) = link.request(Request::GetBoard)? {
            file.boards.insert(hex(&link.hello().unique_id), settings.into());
        }
    }
    Ok(file)
}

/// `KEY=VALUE` applied one after the other.
fn changed<T>(mut text: T, changes: &[String]) -> anyhow::Result<T>
where
    T: serde::Serialize + for<'de> serde::Deserialize<'de>,
{
    for change in changes {
        let (key, value) = change.split_once('=').with_context(|| format!("'{change}': write KEY=VALUE"))?;
        text = with_key(&text, key.trim(), value.trim())?;
    }
    Ok(text)
}

fn set_axis(bench: &mut Bench, axis: AxisName, changes: &[String]) -> anyhow::Result<()> {
    let text = changed(AxisText::from(bench.stage.settings(axis)?), changes)?;
    bench.stage.set_settings(axis, text.try_into()?).with_context(|| axis.to_string())
}

fn set_boards(bench: &mut Bench, changes: &[String]) -> anyhow::Result<()> {
    for link in bench.stage.boards_mut() {
        let Response::Board(settings) = link.request(Request::GetBoard)? else { continue };
        let text = changed(BoardText::from(settings), changes)?;
        link.request(Request::SetBoard { settings: text.into() })?;
    }
    Ok(())
}

fn save(bench: &mut Bench) -> anyhow::Result<()> {
    for link in bench.stage.boards_mut() {
        link.request(Request::Save)?;
    }
    Ok(())
}

/// Takes all settings of a file; when the board refuses one, those already taken are put back.
fn import(bench: &mut Bench, file: SettingsFile) -> anyhow::Result<()> {
    if file.schema > SCHEMA {
        bail!("schema = {}: written by a newer program; this one reads up to {SCHEMA}", file.schema);
    }
    let mut taken = Vec::new();
    for (name, text) in file.axes {
        let axis: AxisName = name.parse()?;
        let before = bench.stage.settings(axis)?;
        let set = text
            .try_into()
            .map_err(anyhow::Error::from)
            .and_then(|settings| Ok(bench.stage.set_settings(axis, settings)?))
            .with_context(|| format!("axes.{axis}"));
        if let Err(error) = set {
            for (axis, before) in taken.into_iter().rev() {
                bench.stage.set_settings(axis, before)?;
            }
            return Err(error);
        }
        taken.push((axis, before));
    }
    for (id, text) in file.boards {
        let link = bench.stage.boards_mut().iter_mut().find(|l| hex(&l.hello().unique_id) == id);
        let link = link.with_context(|| format!("boards.{id}: is not connected"))?;
        link.request(Request::SetBoard { settings: text.into() })?;
    }
    Ok(())
}
