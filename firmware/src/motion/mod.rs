//! From a wish to move to timed pulses: profiles, pulse trains, rings, axes.

/// Feeds the rings from which DMA plays pulses. Owned by the step interrupt; reached through [`crate::ports::Board::pulses`].
#[derive(Debug, Default)]
pub struct Engine {}
