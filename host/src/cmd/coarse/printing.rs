//! Sheets to print.

use super::super::Output;
use super::{Arguments, stereo};
use anyhow::Context;
use parfocal::calibration::coarse::{MarkerId, sheet};
use serde_json::json;

/// Marker numbers in the order they are printed in.
#[derive(Clone, Debug)]
pub struct Ids(pub Vec<MarkerId>);

/// Reads `0-3,7`.
pub(super) fn ids(text: &str) -> Result<Ids, String> {
    let mut all = Vec::new();
    for part in text.split(',') {
        let (from, to) = part.split_once('-').unwrap_or((part, part));
        let number =
            |s: &str| s.trim().parse::<u16>().map_err(|_| format!("'{part}' is no number and no range: write 0-3,7"));
        let (from, to) = (number(from)?, number(to)?);
        if from > to || to > 586 {
            return Err(format!("'{part}': markers go from 0 to 586, the smaller number first"));
        }
        all.extend((from..=to).map(MarkerId));
    }
    Ok(Ids(all))
}

/// Reads `6x8`.
pub(super) fn columns_and_rows(text: &str) -> Result<(u16, u16), String> {
    let parts = text.split_once('x').and_then(|(a, b)| Some((a.trim().parse().ok()?, b.trim().parse().ok()?)));
    parts.ok_or_else(|| format!("'{text}' is no board: write columns x rows, as in 6x8"))
}

pub(super) fn run(arguments: &Arguments, out: Output) -> anyhow::Result<()> {
    let svg = if arguments.print_board {
        sheet::board(&stereo::board(arguments))?
    } else {
        sheet::markers(&arguments.ids.0, arguments.tag_mm(arguments.load_rig()?.as_ref()))?
    };
    match &arguments.out {
        Some(file) => {
            std::fs::write(file, &svg).with_context(|| format!("{}: cannot be written", file.display()))?;
            out.result(&format!("wrote {}", file.display()), &json!({ "written": file }))
        }
        None => out.result(&svg, &json!({ "svg": svg })),
    }
}
