//! Work that is left and taken up again: no decision holds the board up, however much there is to work out.
//!
//! What takes long (fits, looks through many places) is a state machine whose `step` goes on until a [`Slice`] is used
//! up. The sums are the same, in the same order, however they are cut.

/// Instructions that a slice may take, about; a piece of work that takes more has one for itself. 168 million cycles a
/// second, one and a half an instruction: some 55 µs, so that a decision and the interrupts in it stay below 200.
const SLICE: i32 = 6_000;

/// What is left of a slice.
#[derive(Debug)]
pub struct Slice {
    left: i32,
    begun: bool,
}

impl Slice {
    /// A whole one.
    pub fn new() -> Self {
        Self { left: SLICE, begun: false }
    }

    /// Nothing: to see whether there is any work.
    pub fn none() -> Self {
        Self { left: 0, begun: true }
    }

    /// One that lasts for ever, or for one piece of work only.
    #[cfg(test)]
    pub fn of(instructions: i32) -> Self {
        Self { left: instructions, begun: false }
    }

    /// Whether a piece of work that takes so many instructions, about, may be done in what is left. A whole slice affords any.
    pub fn affords(&mut self, instructions: i32) -> bool {
        if self.begun && instructions > self.left {
            return false;
        }
        (self.left, self.begun) = (self.left.saturating_sub(instructions), true);
        true
    }

    /// Whether anything was done in it.
    pub fn is_begun(&self) -> bool {
        self.begun
    }
}
