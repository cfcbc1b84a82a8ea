//! From a wish to move to timed pulses.
//!
//! A [`Motion`] plans on the thread side: [`path`] (jerk-limited), one [`lane`] an axis, [`phase`]s in the axis' own steps. The
//! [`engine`] turns phases into records a few milliseconds ahead, in the step interrupt, and the timers play them.
//! Nothing here knows the hardware: see [`crate::ports::Board`] and [`engine::StepTimers`].

mod backlash;
mod camera;
mod edges;
pub mod engine;
mod facade;
mod fixed;
mod homing;
mod jog;
pub mod lane;
pub mod limits;
mod marks;
pub mod math;
mod moves;
pub mod path;
pub mod phase;
pub mod playback;
mod poll;
pub mod record;
mod ring;
mod run;
mod stops;
pub mod stretch;
mod swing;
mod switches;
pub mod track;
mod trigger;

pub use engine::{Engine, SERVICE, StepTimers};
pub use facade::{Ending, Motion, MotionEvent};
pub use record::{RING, Record};
