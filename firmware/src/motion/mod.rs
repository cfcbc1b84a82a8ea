//! From a wish to move to timed pulses: profiles, pulse trains, rings, axes.

pub mod engine;
pub mod math;
pub mod path;
pub mod phase;
pub mod playback;
mod record;
mod ring;
pub mod track;

pub use engine::{CLOCK_PER_TICK, Engine, SERVICE, StepTimers};
pub use record::{LONGEST, RING, Record, SHORTEST};
