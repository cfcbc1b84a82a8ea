//! What is kept over a power cycle: settings when asked, and where the axes rest.
//!
//! A kept position is void from before a motion begins until the axes have rested again, so that a power cut in motion
//! is never mistaken for a clean stop.

use crate::motion::Motion;
use crate::ports::{Board, Keep, RestingPosition};
use parfocal_protocol::message::{Refusal, Trust};
use parfocal_protocol::settings::BoardSettings;
use parfocal_protocol::units::{AXES, Axis, BoardTime};

/// Rest after which a position is kept: short enough to be kept before anyone reaches the switch, long enough to spare
/// the flash during a scan.
const REST_US: u64 = 2_000_000;

/// Whether the place where the axes rest is in flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// What flash says is true.
    Kept,
    /// Flash says nothing; at rest since then, if at rest.
    Void(Option<BoardTime>),
}

/// Keeps the resting place.
#[derive(Clone, Debug)]
pub struct Parking {
    place: Place,
}

impl Parking {
    /// Takes up what was kept when the board was last parked.
    pub fn restore(motion: &mut Motion, board: &mut impl Board, kept: Option<&[RestingPosition; AXES]>) -> Self {
        let Some(kept) = kept else { return Self { place: Place::Void(None) } };
        for (i, resting) in kept.iter().enumerate() {
            let axis = Axis(i as u8);
            let trust = if !resting.known {
                Trust::Unknown
            } else if motion.settings(axis).parks_exactly(resting.steps) {
                Trust::Restored
            } else {
                Trust::RestoredRoughly
            };
            // Nothing moves yet, and the axis exists: it cannot be refused.
            let _ = motion.restore(board, axis, resting.steps, trust);
        }
        Self { place: Place::Kept }
    }

    /// Before a motion: what flash says will no longer be true.
    pub fn leave(&mut self, board: &mut impl Board) {
        if self.place == Place::Kept {
            // A full queue means that an older note of the same is under way.
            board.keep(Keep::Position(None));
        }
        self.place = Place::Void(None);
    }

    /// Keeps the resting place once everything has rested for a while.
    pub fn poll(&mut self, now: BoardTime, motion: &Motion, board: &mut impl Board) {
        let Place::Void(since) = self.place else { return };
        if !motion.in_position() || motion.emergency_in_force() {
            self.place = Place::Void(None);
            return;
        }
        let since = since.unwrap_or(now);
        self.place = Place::Void(Some(since));
        if now.since(since) < REST_US {
            return;
        }
        let resting = core::array::from_fn(|i| {
            let (steps, known) = motion.resting_steps(board, Axis(i as u8));
            RestingPosition { steps, known }
        });
        if board.keep(Keep::Position(Some(resting))) {
            self.place = Place::Kept;
        }
    }

    /// Keeps all settings.
    ///
    /// # Errors
    /// [`Refusal::CannotSave`].
    pub fn save(&mut self, motion: &Motion, settings: &BoardSettings, board: &mut impl Board) -> Result<(), Refusal> {
        let mut kept = board.keep(Keep::Board(*settings));
        for i in 0..AXES {
            kept &= board.keep(Keep::Axis(i, *motion.settings(Axis(i as u8))));
        }
        if kept { Ok(()) } else { Err(Refusal::CannotSave) }
    }
}
