//! Work that is left and taken up again: no decision holds the board up, however much there is to work out.
//!
//! What takes long (fits, looks through many places) is a state machine whose `step` goes on until a [`Slice`] is used
//! up. The sums are the same, in the same order, however they are cut.

/// Instructions that a slice may take, about; one that was begun is finished. 168 million cycles a second, one and a half
/// an instruction: some 70 µs, so that a decision and the interrupts in it stay below 200.
const SLICE: i32 = 8_000;

/// What is left of a slice.
#[derive(Debug)]
pub struct Slice(i32);

impl Slice {
    /// A whole one.
    pub fn new() -> Self {
        Self(SLICE)
    }

    /// One that lasts for ever, or for one piece of work only.
    #[cfg(test)]
    pub fn of(instructions: i32) -> Self {
        Self(instructions)
    }

    /// Takes off what a piece of work costs, about.
    pub fn spend(&mut self, instructions: i32) {
        self.0 = self.0.saturating_sub(instructions);
    }

    /// Whether anything was done in it.
    pub fn is_begun(&self) -> bool {
        self.0 < SLICE
    }

    /// Whether nothing is left for another piece of work.
    pub fn is_over(&self) -> bool {
        self.0 <= 0
    }
}
