//! Autofocus, seen from the host: the board decides every move and asks for samples, the host answers with focus values.
//!
//! [`focus`] is all of it for one axis, one source of values and one [`Plan`]. [`latency`] calibrates a camera that does not
//! tell when it exposes.

pub mod dating;
pub mod latency;
mod plan;
pub mod plot;
pub mod recorded;
mod run;
pub mod source;

pub use crate::frames::pacing::Latency;
pub use plan::{AutofocusError, Plan, REACH, Span, focus};
pub use run::{Progress, Sample, ScanError, Scanned, compare_clocks, run};
pub use source::{CameraSource, FocusSource, SourceError};
