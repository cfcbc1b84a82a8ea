//! Why a calibration was refused. Nothing is changed then: the old one stays in force.

use super::robust::SolveError;
use std::path::PathBuf;
use thiserror::Error;

/// Why samples gave no calibration. Rows count from 1, the header not counted.
#[derive(Debug, Error)]
pub enum CalibrationError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the reader said.
        source: csv::Error,
    },
    /// A column is not there.
    #[error("the samples have no column {missing}: they need {needed}")]
    Column {
        /// The first one missing.
        missing: String,
        /// All that are needed.
        needed: String,
    },
    /// A field is not a finite number.
    #[error("row {row}, {column}: '{text}' is not a finite number")]
    Number {
        /// Row.
        row: usize,
        /// Column's name.
        column: String,
        /// What stands there.
        text: String,
    },
    /// A pixel is not on the sensor.
    #[error(
        "row {row}: pixel ({x_px}, {y_px}) is not on the sensor of {width}x{height}: are these columns in px, and --image-size right?"
    )]
    OffSensor {
        /// Row.
        row: usize,
        /// Its pixel.
        x_px: f64,
        /// Its pixel.
        y_px: f64,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Fewer samples than unknowns.
    #[error("{have} samples are too few: {what} needs at least {need}; move somewhere new and take more")]
    TooFew {
        /// The calibration.
        what: &'static str,
        /// Samples there are.
        have: usize,
        /// Samples it takes.
        need: usize,
    },
    /// Two samples at one place.
    #[error("rows {first} and {second} were taken at the same {what} position: delete one, or move in between")]
    Repeated {
        /// Row.
        first: usize,
        /// Row.
        second: usize,
        /// What did not move.
        what: &'static str,
    },
    /// All samples close together.
    #[error("the {what} positions span only {extent:.3} {unit}: move at least {least} {unit} apart")]
    TooClose {
        /// What did not move enough.
        what: &'static str,
        /// Largest extent.
        extent: f64,
        /// Its unit.
        unit: &'static str,
        /// What is wanted.
        least: f64,
    },
    /// All samples on a line, or in a plane.
    #[error("the {what} positions lie {on} (only {across:.3} {unit} off it): move along {along} as well")]
    Flat {
        /// What moved too little.
        what: &'static str,
        /// "on a line" or "in a plane".
        on: &'static str,
        /// Spread across it.
        across: f64,
        /// Its unit.
        unit: &'static str,
        /// The direction that is missing.
        along: String,
    },
    /// Columns that cannot be in their unit.
    #[error("{0}")]
    Units(String),
    /// The model is wrong for these points.
    #[error(
        "the {model} model does not fit: {rms_um:.1} µm rms and {max_um:.1} µm at worst, where the affine one leaves {affine_rms_um:.2} µm ({why}): use --model affine"
    )]
    WrongModel {
        /// Asked for.
        model: &'static str,
        /// Its error over the affine model's inliers.
        rms_um: f64,
        /// Its largest error there.
        max_um: f64,
        /// The affine model's error.
        affine_rms_um: f64,
        /// What the affine map shows.
        why: String,
    },
    /// The points have two answers.
    #[error("{0}")]
    Ambiguous(String),
    /// The solver's refusal.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// An option that is needed for these columns.
    #[error("{0}")]
    Missing(String),
}
