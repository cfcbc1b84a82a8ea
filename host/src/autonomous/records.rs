//! The folder of a run: a file of samples for each calibration, taken up again when a run is begun again.

use super::error::AutoError;
use crate::calibration::samples::Table;
use crate::procedure::{Purpose, Recorder};
use std::path::{Path, PathBuf};

/// A run's folder.
#[derive(Clone, Debug)]
pub struct Records {
    folder: Option<PathBuf>,
    seed: u64,
}

/// A file of samples, with those that were in it.
pub struct Opened {
    /// Keeps further ones.
    pub recorder: Recorder,
    /// What an earlier run left.
    pub earlier: Option<Table>,
}

impl Records {
    /// Samples are kept in `folder`, or in memory only.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn new(folder: Option<&Path>, seed: u64) -> Result<Self, AutoError> {
        if let Some(folder) = folder {
            std::fs::create_dir_all(folder).map_err(|e| failed(folder, &e))?;
        }
        Ok(Self { folder: folder.map(Into::into), seed })
    }

    /// The newest file called `stem`, or a new one.
    ///
    /// # Errors
    /// A file that is not one of samples.
    pub fn open(&self, stem: &str, purpose: Purpose) -> Result<Opened, AutoError> {
        let Some(folder) = &self.folder else {
            return Ok(Opened { recorder: Recorder::memory(purpose), earlier: None });
        };
        let newest = (1..).map(|k| named(folder, stem, k)).take_while(|path| path.exists()).last();
        let Some(path) = newest else { return self.anew(stem, purpose) };
        let recorder = Recorder::resume(&path, purpose)?;
        Ok(Opened { recorder, earlier: Some(Table::read(&path)?) })
    }

    /// A new file called `stem`, whatever there is.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn anew(&self, stem: &str, purpose: Purpose) -> Result<Opened, AutoError> {
        let Some(folder) = &self.folder else {
            return Ok(Opened { recorder: Recorder::memory(purpose), earlier: None });
        };
        let about = [format!("parfocal calibrate all --auto, seed {}", self.seed)];
        for k in 1.. {
            let path = named(folder, stem, k);
            if !path.exists() {
                return Ok(Opened { recorder: Recorder::file(&path, purpose, &about)?, earlier: None });
            }
        }
        unreachable!("some number is free")
    }
}

fn named(folder: &Path, stem: &str, k: u32) -> PathBuf {
    folder.join(if k == 1 { format!("{stem}.csv") } else { format!("{stem}-{k}.csv") })
}

fn failed(path: &Path, error: &std::io::Error) -> AutoError {
    AutoError::Records { path: path.display().to_string(), reason: error.to_string() }
}
