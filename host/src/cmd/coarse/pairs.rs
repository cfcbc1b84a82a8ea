//! Stereo pairs in a folder: `place_K_left.png` and `place_K_right.png`.

use anyhow::{Context, bail};
use parfocal::calibration::coarse::edges::Grey;
use parfocal::calibration::coarse::{Pair, Place, Side};
use parfocal::frames::image_file;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const ENDINGS: [&str; 5] = ["png", "tif", "tiff", "jpg", "jpeg"];

/// Reads all pairs of a folder, in the order of their numbers.
pub(super) fn read(folder: &Path) -> anyhow::Result<Vec<Pair>> {
    let files = std::fs::read_dir(folder).with_context(|| format!("{}: cannot be listed", folder.display()))?;
    let mut found: BTreeMap<Place, [Option<PathBuf>; 2]> = BTreeMap::new();
    for file in files {
        let path = file.with_context(|| format!("{}: cannot be listed", folder.display()))?.path();
        let Some((place, side)) = path.file_name().and_then(|n| n.to_str()).and_then(parse) else { continue };
        if let Some(other) = found.entry(place).or_default()[side as usize].replace(path.clone()) {
            bail!("place {place} has two {side} pictures, {} and {}: remove one", other.display(), path.display());
        }
    }
    if found.is_empty() {
        bail!("{} holds no pictures place_K_left.png and place_K_right.png", folder.display());
    }
    let mut pairs = Vec::new();
    for (place, files) in found {
        let [Some(left), Some(right)] = files else {
            let missing = if files[0].is_none() { Side::Left } else { Side::Right };
            bail!(
                "place {place} of {} has no {missing} picture: a single (mono) picture gives no depth; add place_{place}_{missing}.png",
                folder.display()
            );
        };
        pairs.push(Pair { place, left: grey(&left)?, right: grey(&right)? });
    }
    Ok(pairs)
}

/// The place and the side that a file's name gives.
fn parse(name: &str) -> Option<(Place, Side)> {
    let (stem, ending) = name.rsplit_once('.')?;
    if !ENDINGS.iter().any(|e| ending.eq_ignore_ascii_case(e)) {
        return None;
    }
    let (number, side) = stem.strip_prefix("place_")?.split_once('_')?;
    let side = match side {
        "left" => Side::Left,
        "right" => Side::Right,
        _ => return None,
    };
    Some((Place(number.parse().ok()?), side))
}

fn grey(path: &Path) -> anyhow::Result<Grey> {
    let (picture, note) = image_file::read(path)?;
    if let Some(note) = note {
        eprintln!("{}: {note}", path.display());
    }
    Ok(Grey::from(&picture))
}
