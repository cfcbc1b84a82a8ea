//! What a board is told about its axes and itself, kept on the board over a power cycle.

use crate::units::{
    Hertz, MicrometresPerSecond, MicrometresPerSecond2, MicrometresPerSecond3, Milliseconds, Nanometres, Steps,
    StepsPerMicrometre,
};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Timing that a stepper driver asks of STEP and DIR, from its data sheet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Driver {
    /// Allegro A4988: STEP 1 µs high and low, DIR 200 ns before and after.
    #[default]
    A4988,
    /// TI DRV8825: STEP 1.9 µs high and low, DIR 650 ns before and after.
    Drv8825,
    /// Trinamic TMC2209: STEP 100 ns high and low, DIR 20 ns before and after.
    Tmc2209,
    /// Any other driver: 5 µs for everything.
    External,
}

/// Which edges of STEP a driver takes as a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Edges {
    /// The rising edge.
    #[default]
    Rising,
    /// Both (TMC2209 with DEDGE set): twice the steps for the same pulses.
    Both,
}

/// One of the two ends of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Side {
    /// Towards smaller positions.
    Low,
    /// Towards larger positions.
    High,
}

/// How a home or limit switch reads when something presses it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Polarity {
    /// Normally closed to ground: pressed, or the wire broken, reads high. The safe choice.
    #[default]
    PressedHigh,
    /// Normally open: pressed reads low. A broken wire goes unseen.
    PressedLow,
}

/// Settings of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub struct AxisSettings {
    /// Motor (micro)steps in a µm.
    pub steps_per_um: StepsPerMicrometre,
    /// Microsteps that make a full step, as the driver is strapped.
    pub microsteps: u16,
    /// Fastest speed.
    pub speed: MicrometresPerSecond,
    /// Largest acceleration.
    pub acceleration: MicrometresPerSecond2,
    /// Largest jerk.
    pub jerk: MicrometresPerSecond3,
    /// Lowest position that a move may have as its end.
    pub low: Nanometres,
    /// Highest position that a move may have as its end.
    pub high: Nanometres,
    /// Whether a larger position means DIR low.
    pub inverted: bool,
    /// The stepper driver's timing.
    pub driver: Driver,
    /// Which edges of STEP are steps.
    pub edges: Edges,
    /// Play of the screw: how far the motor turns after a reversal before the stage follows.
    pub backlash: Nanometres,
    /// The side from which every move ends, if it matters: the last stretch goes away from this side.
    pub approach: Option<Side>,
    /// Rest after the last edge before the axis counts as in position.
    pub settling: Milliseconds,
    /// The end with the home switch, if there is one.
    pub home: Option<Side>,
    /// Speed towards the home switch.
    pub home_speed: MicrometresPerSecond,
    /// Position of the home switch's edge.
    pub home_at: Nanometres,
    /// How the limit switches read.
    pub switches: Polarity,
    /// Whether limit switches are wired at all.
    pub has_switches: bool,
    /// Whether the driver's current is cut when the axis rests. A needle then drifts: off unless asked for.
    pub idle_off: bool,
}

impl Default for AxisSettings {
    /// A 1.8° motor at 16 microsteps on a 320 µm screw: careful, and safe to connect.
    fn default() -> Self {
        Self {
            steps_per_um: StepsPerMicrometre(10.0),
            microsteps: 16,
            speed: MicrometresPerSecond(1000.0),
            acceleration: MicrometresPerSecond2(10_000.0),
            jerk: MicrometresPerSecond3(1_000_000.0),
            low: Nanometres(-1_000_000),
            high: Nanometres(1_000_000),
            inverted: false,
            driver: Driver::A4988,
            edges: Edges::Rising,
            backlash: Nanometres(0),
            approach: None,
            settling: Milliseconds(20),
            home: None,
            home_speed: MicrometresPerSecond(200.0),
            home_at: Nanometres(0),
            switches: Polarity::PressedHigh,
            has_switches: false,
            idle_off: false,
        }
    }
}

impl AxisSettings {
    /// Whether a driver that is switched on again holds its motor exactly at `steps`: it starts at one fixed phase of the four
    /// full steps of its cycle, and anywhere else the motor jumps by up to two full steps.
    pub fn parks_exactly(&self, steps: Steps) -> bool {
        steps.0.rem_euclid(4 * i32::from(self.microsteps.max(1))) == 0
    }
}

/// Settings of the board as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub struct BoardSettings {
    /// Host silence after which a host-driven operation is stopped.
    pub host_timeout: Milliseconds,
    /// How often the position is told while something moves.
    pub telemetry: Hertz,
    /// Whether an emergency-stop input is wired.
    pub has_emergency_stop: bool,
}

impl Default for BoardSettings {
    fn default() -> Self {
        Self { host_timeout: Milliseconds(1000), telemetry: Hertz(100.0), has_emergency_stop: false }
    }
}
