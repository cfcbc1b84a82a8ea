//! Poses measured by another tracker, as rows `view,marker,qw,qx,qy,qz,x_mm,y_mm,z_mm`: marker → tracker.

use super::graph::View;
use super::{Degrees, MarkerId, Millimetres, Place};
use nalgebra::{Isometry3, Matrix6, Quaternion, Translation3, UnitQuaternion, Vector6};
use std::collections::HashSet;
use thiserror::Error;

/// The first line of the file.
pub const HEADER: &str = "view,marker,qw,qx,qy,qz,x_mm,y_mm,z_mm";

/// Why a file of poses cannot be read.
#[derive(Debug, Error, PartialEq)]
pub enum PosesError {
    /// Another first line.
    #[error("the first line of the poses is '{0}': it has to be '{HEADER}'")]
    Header(String),
    /// A row with more or fewer fields.
    #[error("line {line} has {count} fields: give 9, {HEADER}")]
    Fields {
        /// Counted from 1.
        line: usize,
        /// Fields it has.
        count: usize,
    },
    /// Not a number, or one that cannot be.
    #[error("line {line}, {field}: '{text}' is {why}")]
    Value {
        /// Counted from 1.
        line: usize,
        /// The column's name.
        field: &'static str,
        /// What stands there.
        text: String,
        /// What is wrong.
        why: &'static str,
    },
    /// A quaternion that does not turn.
    #[error("line {line}: the quaternion's length is {length:.3}: it has to be 1, qw first")]
    NotUnit {
        /// Counted from 1.
        line: usize,
        /// What it is.
        length: f64,
    },
    /// A marker twice in a view.
    #[error("line {line}: marker {marker} is a second time in view {view}: give each marker once a view")]
    Twice {
        /// Counted from 1.
        line: usize,
        /// The marker.
        marker: MarkerId,
        /// The view.
        view: Place,
    },
    /// No rows.
    #[error("the file holds no poses: give rows {HEADER}")]
    Empty,
}

/// How good the tracker is: standard deviation of each coordinate and of each rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tracker {
    /// Of x, y and z.
    pub position: Millimetres,
    /// About each axis.
    pub orientation: Degrees,
}

/// Reads a file of poses.
///
/// # Errors
/// [`PosesError`], naming line and field.
pub fn read(text: &str, tracker: Tracker) -> Result<Vec<View>, PosesError> {
    let mut lines = text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty() && !l.starts_with('#'));
    let (_, first) = lines.next().ok_or(PosesError::Empty)?;
    let names: Vec<&str> = first.trim_start_matches('\u{feff}').split(',').map(str::trim).collect();
    if names.join(",") != HEADER {
        return Err(PosesError::Header(first.into()));
    }
    let (mm, rad) = (tracker.position.0.powi(-2), tracker.orientation.0.to_radians().powi(-2));
    let information = Matrix6::from_diagonal(&Vector6::new(mm, mm, mm, rad, rad, rad));
    let mut seen = HashSet::new();
    let mut views = Vec::new();
    for (k, text) in lines {
        let line = k + 1;
        let fields: Vec<&str> = text.split(',').map(str::trim).collect();
        if fields.len() != 9 {
            return Err(PosesError::Fields { line, count: fields.len() });
        }
        let bad = |k: usize, why| {
            let field = HEADER.split(',').nth(k).unwrap_or("");
            PosesError::Value { line, field, text: fields[k].into(), why }
        };
        let number = |k: usize| match fields[k].parse::<f64>() {
            Ok(v) if v.is_finite() => Ok(v),
            _ => Err(bad(k, "not a number")),
        };
        let place = Place(fields[0].parse().map_err(|_| bad(0, "no whole number from 0"))?);
        let marker = MarkerId(fields[1].parse().map_err(|_| bad(1, "no marker's number"))?);
        let q = Quaternion::new(number(2)?, number(3)?, number(4)?, number(5)?);
        if (q.norm() - 1.0).abs() > 0.02 {
            return Err(PosesError::NotUnit { line, length: q.norm() });
        }
        if !seen.insert((place, marker)) {
            return Err(PosesError::Twice { line, marker, view: place });
        }
        let at = Translation3::new(number(6)?, number(7)?, number(8)?);
        let pose = Isometry3::from_parts(at, UnitQuaternion::from_quaternion(q));
        views.push(View { place, marker, pose, information });
    }
    if views.is_empty() { Err(PosesError::Empty) } else { Ok(views) }
}
