//! Units of everything that crosses the link. No bare number has a meaning of its own.

use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

macro_rules! unit {
    ($(#[$doc:meta])* $name:ident($inner:ty)) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize, Schema, MaxSize)]
        pub struct $name(pub $inner);
    };
    ($(#[$doc:meta])* $name:ident($inner:ty), exact) => {
        $(#[$doc])*
        #[derive(
            Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Schema, MaxSize,
        )]
        pub struct $name(pub $inner);
    };
}

unit!(
    /// A position or distance in motor (micro)steps: what the board counts.
    Steps(i32), exact
);
unit!(
    /// A position or distance in whole nanometres: what the link carries, exact in both directions. ±2.1 m.
    Nanometres(i32), exact
);
unit!(
    /// A position or distance in µm: what people read and the host computes with.
    Micrometres(f64)
);
unit!(
    /// Speed, µm/s.
    MicrometresPerSecond(f32)
);
unit!(
    /// Acceleration, µm/s².
    MicrometresPerSecond2(f32)
);
unit!(
    /// Jerk, µm/s³.
    MicrometresPerSecond3(f32)
);
unit!(
    /// Motor (micro)steps in a µm.
    StepsPerMicrometre(f32)
);
unit!(
    /// Ticks of the step timers, 84 MHz: 11.9 ns each.
    Ticks(u64), exact
);
unit!(
    /// The board's clock: µs since it started.
    BoardTime(u64), exact
);
unit!(
    /// The host's clock: µs since an instant of its own choice.
    HostTime(u64), exact
);
unit!(
    /// A span of time in ms.
    Milliseconds(u32), exact
);
unit!(
    /// Frequency, Hz.
    Hertz(f32)
);
unit!(
    /// The value Φ of a focus measure: larger is sharper, the scale is the measure's own.
    FocusValue(f64)
);
unit!(
    /// An axis of one board, counted from 0.
    Axis(u8), exact
);

/// Axes a board has at most.
pub const AXES: usize = 4;

/// Frequency of the step timers: the unit of [`Ticks`].
pub const TICKS_PER_SECOND: u64 = 84_000_000;

impl Axis {
    /// The axis as an index into arrays of [`AXES`] elements; `None` for an axis no board has.
    pub fn index(self) -> Option<usize> {
        (usize::from(self.0) < AXES).then_some(self.0.into())
    }
}

impl Nanometres {
    /// In µm, exactly.
    pub fn micrometres(self) -> Micrometres {
        Micrometres(f64::from(self.0) / 1000.0)
    }
}

impl Micrometres {
    /// Rounded to the nearest nanometre; `None` when not finite or beyond ±2.1 m.
    pub fn nanometres(self) -> Option<Nanometres> {
        let nm = self.0 * 1000.0;
        let rounded = if nm < 0.0 { nm - 0.5 } else { nm + 0.5 };
        // `as` truncates towards zero, so this rounds half away from it; NaN fails the comparison.
        (rounded > f64::from(i32::MIN) && rounded < f64::from(i32::MAX)).then_some(Nanometres(rounded as i32))
    }
}

impl StepsPerMicrometre {
    /// The step nearest to a position; saturates at the ends of [`Steps`].
    pub fn steps(self, at: Nanometres) -> Steps {
        let exact = f64::from(at.0) * f64::from(self.0) / 1000.0;
        Steps((if exact < 0.0 { exact - 0.5 } else { exact + 0.5 }) as i32)
    }

    /// Where a step lies; saturates at the ends of [`Nanometres`].
    pub fn nanometres(self, at: Steps) -> Nanometres {
        let exact = f64::from(at.0) * 1000.0 / f64::from(self.0);
        Nanometres((if exact < 0.0 { exact - 0.5 } else { exact + 0.5 }) as i32)
    }
}

impl BoardTime {
    /// µs from `earlier` to this; 0 when `earlier` is later.
    pub fn since(self, earlier: BoardTime) -> u64 {
        self.0.saturating_sub(earlier.0)
    }
}

/// What is known of each axis of a board, by axis.
pub type PerAxis<T> = [T; AXES];

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn steps_and_nanometres_agree_to_half_a_step(steps in -1_000_000i32..1_000_000, per_um in 0.5f32..400.0) {
            let scale = StepsPerMicrometre(per_um);
            let at = scale.nanometres(Steps(steps));
            // A step shorter than a nanometre cannot come back: the scale above keeps it longer.
            prop_assert_eq!(scale.steps(at), Steps(steps));
        }

        #[test]
        fn micrometres_round_to_the_nearest_nanometre(nm in i32::MIN + 1..i32::MAX) {
            prop_assert_eq!(Nanometres(nm).micrometres().nanometres(), Some(Nanometres(nm)));
        }
    }

    #[test]
    fn positions_that_no_stage_reaches_are_none() {
        for um in [f64::NAN, f64::INFINITY, -3e6, 3e6] {
            assert_eq!(Micrometres(um).nanometres(), None);
        }
    }
}
