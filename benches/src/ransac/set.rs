//! One set of point pairs, as the bench's files spell it.

use anyhow::Context;
use nalgebra::SVector;
use serde::{Deserialize, Serialize};

/// Pairs of points, of which some are wrong.
#[derive(Debug, Serialize, Deserialize)]
pub struct Set {
    pub kind: String,
    pub n: usize,
    pub out: f64,
    pub trial: u64,
    pub tol: f64,
    pub src: Vec<Vec<f64>>,
    pub dst: Vec<Vec<f64>>,
    /// For the score only; the solver sees `src`, `dst` and `tol`.
    pub sigma: Option<f64>,
    pub inlier: Option<Vec<u8>>,
    pub truth: Option<Vec<Vec<f64>>>,
}

impl Set {
    /// Its rows as vectors.
    ///
    /// # Errors
    /// When a row has another length.
    pub fn points<const D: usize>(&self, rows: &[Vec<f64>]) -> anyhow::Result<Vec<SVector<f64, D>>> {
        let whole = |row: &Vec<f64>| (row.len() == D).then(|| SVector::from_column_slice(row));
        let points: Option<_> = rows.iter().map(whole).collect();
        points.with_context(|| format!("trial {}: points are not {D}-D", self.trial))
    }
}
