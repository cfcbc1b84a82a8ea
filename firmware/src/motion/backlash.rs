//! Play of the screw: the motor turns after a reversal before the stage follows.
//!
//! `slack` is how much of the play lies taken up on the upper side: 0 after a motion down, all of it after one up, when the
//! motor's count is ahead of the stage by that much. The stage stands at `motor − slack`.

use parfocal_protocol::settings::Side;

/// Least overshoot of a move that must end from a given side, µm.
pub const OVERSHOOT_UM: f64 = 1.0;

/// Play of one axis, in steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Play {
    /// All of it.
    pub width: i32,
    /// What is taken up on the upper side, 0 to `width`.
    pub slack: i32,
}

/// Motor counts to go to, one after the other, for one move of the stage. `None`: the axis rests in that leg.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Legs {
    /// Takes up the play; the stage rests.
    pub take_up: Option<i32>,
    /// The move itself.
    pub main: Option<i32>,
    /// Back from the overshoot, towards the side that the move must end in.
    pub approach: Option<i32>,
}

impl Play {
    /// The motor moved by `steps`.
    pub fn moved(&mut self, steps: i32) {
        self.slack = self.slack.saturating_add(steps).clamp(0, self.width);
    }

    /// The width changed; what was taken up stays on its side.
    pub fn set_width(&mut self, width: i32) {
        self.slack = if self.slack > 0 && self.slack == self.width { width } else { self.slack.min(width) };
        self.width = width;
    }

    /// How to bring the stage from `from` to `to` (steps), ending in a motion away from `approach`; `overshoot` steps beyond
    /// where the last stretch begins.
    pub fn legs(&self, from: i32, to: i32, approach: Option<Side>, overshoot: i32) -> Legs {
        let last_up = approach.map(|side| side == Side::Low);
        let loaded = |up: bool| if up { self.width } else { 0 };
        let settled = last_up.is_none_or(|up| self.slack == loaded(up));
        if from == to && settled {
            return Legs::default();
        }
        // A move that stays must turn back once: it begins against its last direction.
        let up = if from == to { last_up == Some(false) } else { to > from };
        let take_up = (self.slack != loaded(up)).then(|| from.saturating_add(loaded(up)));
        match last_up {
            Some(last) if last != up => {
                let beyond = to.saturating_add(if up { overshoot } else { -overshoot });
                Legs {
                    take_up,
                    main: Some(beyond.saturating_add(loaded(up))),
                    approach: Some(to.saturating_add(loaded(last))),
                }
            }
            _ => Legs { take_up, main: Some(to.saturating_add(loaded(up))), approach: None },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A screw with play, the simple way: the nut pushes the stage from one side or the other.
    struct Stage {
        motor: i32,
        at: i32,
        width: i32,
    }

    impl Stage {
        fn turn(&mut self, to: i32) {
            self.motor = to;
            self.at = self.at.clamp(to - self.width, to);
        }
    }

    proptest! {
        #[test]
        fn the_stage_arrives_from_the_asked_side(
            width in 0i32..200,
            side in prop_oneof![Just(None), Just(Some(Side::Low)), Just(Some(Side::High))],
            targets in proptest::collection::vec(-10_000i32..10_000, 1..20),
        ) {
            let mut play = Play { width, slack: 0 };
            let mut stage = Stage { motor: 0, at: 0, width };
            for to in targets {
                let legs = play.legs(stage.motor - play.slack, to, side, 50);
                let mut last = None;
                if let Some(motor) = legs.take_up {
                    let before = stage.at;
                    play.moved(motor - stage.motor);
                    stage.turn(motor);
                    prop_assert_eq!(stage.at, before, "the stage moved while play was taken up");
                }
                // The last leg may end where the play was taken up.
                for motor in [legs.main, legs.approach].into_iter().flatten() {
                    last = Some(motor > stage.motor);
                    play.moved(motor - stage.motor);
                    stage.turn(motor);
                }
                prop_assert_eq!(stage.at, to);
                prop_assert_eq!(stage.motor - play.slack, to);
                if let (Some(side), Some(up)) = (side, last) {
                    prop_assert_eq!(up, side == Side::Low);
                }
            }
        }
    }
}
