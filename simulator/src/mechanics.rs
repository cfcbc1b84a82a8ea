//! What lies between motor and stage: a screw with play, and a carriage that takes a moment to come to rest.

use parfocal_protocol::units::Micrometres;

/// A stage's imperfections.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stage {
    /// Play of the screw: after a reversal the motor turns this far before the stage follows, µm.
    pub backlash_um: f64,
    /// Time constant with which the stage follows the screw, ms; 0 is rigid.
    pub lag_ms: f64,
}

impl Stage {
    /// A stage without faults.
    pub const PERFECT: Self = Self { backlash_um: 0.0, lag_ms: 0.0 };
}

/// A stage in motion.
#[derive(Clone, Copy, Debug)]
pub struct Mechanics {
    stage: Stage,
    /// Where the screw's nut is.
    nut_um: f64,
    /// Where the carriage is.
    carriage_um: f64,
}

impl Mechanics {
    /// A stage at rest at `at`, its play taken up in the direction of growing positions.
    pub fn new(stage: Stage, at: Micrometres) -> Self {
        Self { stage, nut_um: at.0, carriage_um: at.0 }
    }

    /// Lets `dt_us` µs pass with the motor at `motor` at their end; the carriage's position comes back.
    ///
    /// The nut is pushed by either flank of the thread: `motor - play <= nut - … <= motor` (the play operator, Krasnosel'skii
    /// and Pokrovskii, Systems with Hysteresis, 1989). With the play taken up upwards nut and motor agree.
    pub fn follow(&mut self, motor: Micrometres, dt_us: u64) -> Micrometres {
        self.nut_um = self.nut_um.clamp(motor.0, motor.0 + self.stage.backlash_um);
        let lag_us = self.stage.lag_ms * 1000.0;
        let kept = if lag_us > 0.0 { (-(dt_us as f64) / lag_us).exp() } else { 0.0 };
        self.carriage_um = self.nut_um + (self.carriage_um - self.nut_um) * kept;
        Micrometres(self.carriage_um)
    }

    /// Where the carriage is.
    pub fn position(&self) -> Micrometres {
        Micrometres(self.carriage_um)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reversal_loses_the_play_and_a_return_finds_it_again() {
        let mut stage = Mechanics::new(Stage { backlash_um: 3.0, lag_ms: 0.0 }, Micrometres(0.0));
        let mut at = |motor| stage.follow(Micrometres(motor), 1000).0;
        assert_eq!([10.0, 9.0, 7.0, 6.0, 8.0, 9.0, 10.0].map(&mut at), [10.0, 10.0, 10.0, 9.0, 9.0, 9.0, 10.0]);
    }

    #[test]
    fn a_carriage_comes_to_rest_with_its_time_constant() {
        let mut stage = Mechanics::new(Stage { backlash_um: 0.0, lag_ms: 5.0 }, Micrometres(0.0));
        let whole = stage.follow(Micrometres(1.0), 10_000).0;
        let mut other = Mechanics::new(Stage { backlash_um: 0.0, lag_ms: 5.0 }, Micrometres(0.0));
        let mut parts = 0.0;
        for _ in 0..10 {
            parts = other.follow(Micrometres(1.0), 1000).0;
        }
        assert!((whole - (1.0 - (-2.0f64).exp())).abs() < 1e-12 && (whole - parts).abs() < 1e-12);
    }
}
