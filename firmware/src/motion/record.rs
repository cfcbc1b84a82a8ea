//! One period of a step timer, as DMA writes it into the timer's registers.

/// Records in an axis' ring.
pub const RING: usize = 512;

/// Longest record, ticks. Longer waits are split, so that a count of records is also a measure of time: 100 µs.
pub const LONGEST: u32 = 8_400;

/// Shortest record that is ever planned, ticks (0.52 µs). A record costs DMA about 0.5 µs on APB1, so a shorter one might not
/// have arrived when its turn comes.
pub const SHORTEST: u32 = 44;

/// A compare value that is never reached: the output stays high for the whole record. ARR stays below it.
const ALWAYS: u32 = 0xffff;

/// Auto-reload, a reserved word, compare 1 (STEP) and compare 2 (DIR) of a general timer: the four words that one burst
/// writes from ARR on. STEP is high from the record's start until the counter reaches `ccr1`; DIR is high for the whole
/// record or not at all.
#[repr(C, align(16))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Record {
    /// Ticks less one. 0 blocks the counter: the record never ends.
    pub arr: u32,
    /// Written to a reserved address; always 0.
    pub reserved: u32,
    /// Ticks for which STEP is high.
    pub ccr1: u32,
    /// 0xffff for DIR high, 0 for low.
    pub ccr2: u32,
}

impl Record {
    /// STEP is high for the first `high` ticks of `ticks`.
    #[inline(always)]
    pub const fn pulse(ticks: u32, high: u32, dir: u32) -> Self {
        Self { arr: ticks.wrapping_sub(1), reserved: 0, ccr1: high, ccr2: dir }
    }

    /// Copies another record word by word: told to save room, the compiler calls a function of 60 instructions for it.
    #[inline(always)]
    pub fn set(&mut self, other: &Self) {
        self.arr = other.arr;
        self.reserved = other.reserved;
        self.ccr1 = other.ccr1;
        self.ccr2 = other.ccr2;
    }

    /// STEP and DIR keep their levels for `ticks`; with 1 the timer stands still at it.
    #[inline(always)]
    pub const fn hold(ticks: u32, step_high: bool, dir: u32) -> Self {
        Self::pulse(ticks, if step_high { ALWAYS } else { 0 }, dir)
    }

    /// The compare value of a DIR level.
    pub const fn dir(high: bool) -> u32 {
        if high { ALWAYS } else { 0 }
    }

    /// Ticks it lasts; 0 when it never ends.
    pub const fn ticks(&self) -> u32 {
        if self.arr == 0 { 0 } else { self.arr + 1 }
    }

    /// Whether STEP is high as it starts.
    pub const fn starts_high(&self) -> bool {
        self.ccr1 > 0
    }

    /// Whether STEP is high as it ends.
    pub const fn ends_high(&self) -> bool {
        self.ccr1 > self.arr
    }
}

/// How an axis' STEP and DIR are driven, ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pulse {
    /// STEP high time of single-edge stepping.
    pub high: u32,
    /// DIR stands this long before a step.
    pub setup: u32,
    /// Whether both edges of STEP are steps.
    pub both: bool,
    /// Whether larger counts mean DIR low.
    pub inverted: bool,
}
