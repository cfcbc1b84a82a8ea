//! One autofocus, seen from the host: the board asks for samples, the host answers with focus values.

pub mod plot;
mod run;
pub mod source;

pub use run::{AutofocusError, Progress, Sample, Scanned, run};
