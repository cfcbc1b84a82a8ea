//! Live procedures: a rig at work, moved only after looking, that records the samples of its own calibration, and
//! moves by it.
//!
//! Everything that moves goes through a [`Guard`]: soft limits, and every tip on its whole way against every obstacle,
//! before anything moves. A [`LiveRig`] adds the camera: frames that were exposed after the move, focus on a region, and
//! points, which a [`PointFinder`] finds: a person's clicks ([`clicks`]) or the tip detector ([`DetectorFinder`]).
//! The procedures record [`Sample`]s as they come; solving them is [`crate::calibration`]'s.

mod aim;
mod camera;
mod clicks;
mod detector;
mod draw;
pub mod drawing;
mod error;
mod focus;
mod follow;
mod guard;
mod into_view;
mod jog;
mod level;
mod live;
mod objective;
pub mod obstacles;
mod point;
mod record;
mod registration;
mod shank;
mod spiral;
mod survey;

pub use aim::{TipPlace, coaxial, microscope_to_pixel, tip_to, tip_to_pixel, tips};
pub use camera::{CameraPlan, camera, what_moves};
pub use clicks::{Answer, ClickFinder, Clicker, Question, clicks};
pub use detector::DetectorFinder;
pub use draw::{Draws, Share};
pub use error::ProcedureError;
pub use focus::{FocusTask, Focuser, ScanFocuser};
pub use guard::{Guard, Pose, Targets, moves_sample, targets};
pub use into_view::{InView, IntoViewPlan, into_view};
pub use jog::{Jogged, jogged};
pub use live::{LiveRig, Parts, Progress, Seen};
pub use objective::{ObjectivePlan, objectives};
pub use point::{Found, FramePixel, Hint, NotFound, PointFinder, Subject, Window, Witness};
pub use record::{Purpose, Recorder, Sample};
pub use registration::{RegistrationPlan, registration};
pub use shank::{ShankPlan, shank};
pub use survey::{Survey, survey};
