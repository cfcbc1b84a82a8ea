//! Scans for focus: the board decides every move, the host turns frames into values.
//!
//! A [`Scan`] is sans-IO: it is told values and arrivals, and each answer says what it wants next as an [`Ask`].
//!
//! ```
//! use parfocal_firmware::autofocus::{Ask, Scan};
//! use parfocal_protocol::autofocus::{Mode, Outcome, ScanId, ScanParameters, Strategy, Subject};
//! use parfocal_protocol::units::{Axis, FocusValue, MicrometresPerSecond, Milliseconds, Nanometres};
//!
//! let parameters = ScanParameters {
//!     scan: ScanId(1),
//!     axis: Axis(2),
//!     strategy: Strategy::Climb,
//!     mode: Mode::Step,
//!     subject: Subject::Peak,
//!     low: Nanometres(-100_000),
//!     high: Nanometres(100_000),
//!     sample_step: Nanometres(500),
//!     trap: Nanometres(10_000),
//!     probe: Nanometres(5_000),
//!     speed: MicrometresPerSecond(0.0),
//!     sample_timeout: Milliseconds(1_000),
//!     verify: false,
//! };
//! let phi = |z: Nanometres| FocusValue(1.0 / (1.0 + (f64::from(z.0) / 10_000.0 - 3.0).powi(2)));
//! let (mut scan, mut ask) = Scan::begin(&parameters, Nanometres(0)).unwrap();
//! let outcome = loop {
//!     ask = match ask {
//!         Ask::Sample { z } => scan.sample(z, Ok(phi(z))),
//!         Ask::Go { z } => scan.arrived(z),
//!         Ask::Think => scan.think(),
//!         Ask::Ended(outcome) => break outcome,
//!         Ask::Sweep { .. } | Ask::Wait => unreachable!("a stepwise scan"),
//!     };
//! };
//! assert_eq!(outcome, Outcome::Focused);
//! assert!((scan.summary().best.0 - 30_000).abs() < 100);
//! ```

pub mod climb;
pub mod curve;
mod exact;
mod finding;
mod fit;
mod judge;
mod mixed;
mod noise;
mod parameters;
pub mod peak;
mod places;
mod refine;
mod rivals;
mod scan;
pub mod search;
mod tops;
mod valley;
mod whole;
mod work;

pub use scan::{Ask, Scan, Summary};
