//! Places in a ring at which the count of steps is remembered: counting back from the nearest is short.

use super::record::RING;

/// What had been laid when a record was about to be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mark {
    /// That record.
    pub record: u32,
    /// Steps of all records before it.
    pub steps: i32,
    /// Tick at which it begins, modulo 2³².
    pub tick: u32,
}

/// Marks of one ring.
const MARKS: usize = 16;

/// Records between two marks at least: so that they span the ring.
pub const SPACING: u32 = (RING / MARKS) as u32;

/// The latest marks of a ring.
#[derive(Debug)]
pub struct Marks {
    marks: [Mark; MARKS],
    latest: usize,
}

impl Marks {
    /// None that means anything; [`Self::restart`] must follow.
    pub const fn new() -> Self {
        Self { marks: [Mark { record: 0, steps: 0, tick: 0 }; MARKS], latest: 0 }
    }

    /// What was remembered no longer holds, but `here` does.
    pub fn restart(&mut self, here: Mark) {
        self.marks = [here; MARKS];
    }

    /// Remembers a mark, if it is far enough from the one before.
    #[inline]
    pub fn note(&mut self, here: Mark) {
        let last = self.marks.get(self.latest).map_or(0, |m| m.record);
        if here.record.wrapping_sub(last) >= SPACING {
            self.latest = (self.latest + 1) % MARKS;
            if let Some(mark) = self.marks.get_mut(self.latest) {
                *mark = here;
            }
        }
    }

    /// The first mark from `record` on; `end` if there is none before it.
    pub fn from(&self, record: u32, end: Mark) -> Mark {
        let ahead = |mark: &Mark| mark.record.wrapping_sub(record);
        self.marks.iter().copied().fold(end, |best, mark| if ahead(&mark) < ahead(&best) { mark } else { best })
    }
}
