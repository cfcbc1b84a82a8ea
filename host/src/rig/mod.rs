//! `rig.toml`: which board and axis is what, and everything that was calibrated.
//!
//! The file is meant to be read and edited by people. A save writes only what changed: comments, order and spelling of
//! the rest stay. It is written beside the old file and then takes its place, so a crash leaves one or the other, whole.
//! A file that does not hold together is refused with the key that is wrong, and the old one stays as it was.
//!
//! ```
//! use parfocal::rig::{Axis, Moves, Rig};
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("rig.toml");
//! let mut rig = Rig::new();
//! rig.set_board("main", "0011aabb".parse()?);
//! rig.set_axis("scope.z".parse()?, Axis { board: "main".into(), index: 2, moves: Some(Moves::Objective) });
//! rig.save(&path)?;
//! let again = Rig::load(&path)?;
//! assert_eq!(again.contents().boards["main"].unique_id.as_str(), "0011aabb");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod certainty;
mod check;
mod contents;
mod markers;
mod merge;
mod names;
mod update;

#[cfg(test)]
mod tests;

pub use certainty::Certainty;
pub use contents::{
    Axis, Board, Camera, CameraCalibration, CameraLatency, Contents, Manipulator, Moves, Objective, Obstacle, Pipette,
    Record, Registration, SCHEMA, TipOffset, Um3, Zoom,
};
pub use markers::{CoarseRegistration, MARKERS, Markers};
pub use names::{AxisName, BoardId, Coordinate, Device, ManipulatorNumber, NameError};
pub use update::TipOffsetWarning;

use std::path::{Path, PathBuf};
use thiserror::Error;
use toml_edit::DocumentMut;

/// A rig's file, read or new.
#[derive(Clone, Debug)]
pub struct Rig {
    contents: Contents,
    /// The file's text as it was read, with the person's comments; none for a new one.
    text: Option<String>,
}

/// Why a `rig.toml` was not read or written.
#[derive(Debug, Error)]
pub enum RigError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}; 'parfocal setup' writes a first one", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write {}: {source}; the old file stays as it was", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not TOML.
    #[error("the rig's file is not TOML: {0}")]
    Syntax(String),
    /// A key is missing, unknown, or of the wrong type.
    #[error("the rig's file: {key}: {why}")]
    Key {
        /// Dotted path of the key.
        key: String,
        /// What is wrong with it.
        why: String,
    },
    /// A value that cannot be.
    #[error("the rig's file: {key} {why}")]
    Value {
        /// Dotted path of the key.
        key: String,
        /// What is wrong with it.
        why: String,
    },
    /// Written by a newer program.
    #[error("the rig's file has schema {found}, this program knows up to {SCHEMA}: update the program")]
    Schema {
        /// What the file says.
        found: u32,
    },
    /// Somebody edited it meanwhile.
    #[error("{} changed since it was read, and was not overwritten: run the command again", path.display())]
    Changed {
        /// The file.
        path: PathBuf,
    },
    /// An update names what is not there.
    #[error("{what} '{name}' is not in the rig's file; it has: {}", known.join(", "))]
    Unknown {
        /// objective, manipulator …
        what: &'static str,
        /// The name asked for.
        name: String,
        /// The names there are.
        known: Vec<String>,
    },
}

impl Default for Rig {
    fn default() -> Self {
        Self::new()
    }
}

impl Rig {
    /// A rig of which nothing is known yet.
    pub fn new() -> Self {
        let contents = Contents {
            schema: SCHEMA,
            name: None,
            objective_in_use: None,
            zoom_in_use: None,
            boards: Default::default(),
            axes: Default::default(),
            camera: None,
            objectives: Default::default(),
            objective_height_um: 0.0,
            manipulators: Default::default(),
            markers: None,
            stereo: None,
            obstacles: Vec::new(),
        };
        Self { contents, text: None }
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`RigError::Read`], or what is wrong with the text, naming the key.
    pub fn load(path: &Path) -> Result<Self, RigError> {
        let text = std::fs::read_to_string(path).map_err(|source| RigError::Read { path: path.into(), source })?;
        Self::parse(&text)
    }

    /// Reads and checks a file's text.
    ///
    /// # Errors
    /// What is wrong with it, naming the key.
    pub fn parse(text: &str) -> Result<Self, RigError> {
        let document: DocumentMut =
            text.parse().map_err(|e: toml_edit::TomlError| RigError::Syntax(e.to_string().trim_end().to_owned()))?;
        // A newer schema may well have keys that this one does not know: say that first.
        if let Some(found) = document.get("schema").and_then(|item| item.as_integer())
            && found > i64::from(SCHEMA)
        {
            return Err(RigError::Schema { found: u32::try_from(found).unwrap_or(u32::MAX) });
        }
        let reader = toml::Deserializer::parse(text).map_err(|e| RigError::Syntax(e.to_string()))?;
        let contents: Contents = serde_path_to_error::deserialize(reader)
            .map_err(|e| RigError::Key { key: e.path().to_string(), why: e.inner().message().to_owned() })?;
        check::check(&contents)?;
        Ok(Self { contents, text: Some(text.to_owned()) })
    }

    /// What the file holds.
    pub fn contents(&self) -> &Contents {
        &self.contents
    }

    /// Changes anything at all; [`Self::save`] checks the result before it writes.
    pub fn contents_mut(&mut self) -> &mut Contents {
        &mut self.contents
    }

    /// The file's text with every change in it.
    ///
    /// # Errors
    /// [`RigError::Value`] when the contents do not hold together.
    pub fn to_text(&self) -> Result<String, RigError> {
        check::check(&self.contents)?;
        let plain = toml::to_string(&self.contents).map_err(|e| RigError::Syntax(e.to_string()))?;
        let Some(text) = &self.text else { return Ok(plain) };
        let parse = |text: &str| text.parse::<DocumentMut>().map_err(|e| RigError::Syntax(e.to_string()));
        let mut document = parse(text)?;
        merge::merge(document.as_table_mut(), parse(&plain)?.as_table());
        Ok(document.to_string())
    }

    /// Writes the file, atomically; nothing is written when the contents do not hold together or the file was changed
    /// by somebody else since it was read.
    ///
    /// # Errors
    /// [`RigError::Value`], [`RigError::Changed`], [`RigError::Write`].
    pub fn save(&mut self, path: &Path) -> Result<(), RigError> {
        let text = self.to_text()?;
        if let (Some(read), Ok(now)) = (&self.text, std::fs::read_to_string(path))
            && *read != now
        {
            return Err(RigError::Changed { path: path.into() });
        }
        write_atomically(path, text.as_bytes()).map_err(|source| RigError::Write { path: path.into(), source })?;
        self.text = Some(text);
        Ok(())
    }
}

/// Writes beside the file, then takes its place.
fn write_atomically(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    use std::io::Write;
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut file = tempfile::Builder::new().prefix(".rig-").suffix(".toml").tempfile_in(folder)?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    // A temporary file is private; the rig's file keeps its rights, or gets the usual ones.
    let rights = std::fs::metadata(path).map(|m| m.permissions()).ok();
    #[cfg(unix)]
    let rights = rights.or_else(|| Some(std::os::unix::fs::PermissionsExt::from_mode(0o644)));
    if let Some(rights) = rights {
        std::fs::set_permissions(file.path(), rights)?;
    }
    file.persist(path).map_err(|e| e.error)?;
    Ok(())
}
