//! What the board can do, and what it therefore refuses when it is asked for.

use super::path::Limits;
use super::record::{Pulse, SHORTEST};
use parfocal_protocol::message::{Field, Refusal};
use parfocal_protocol::settings::{AxisSettings, Driver, Edges};
use parfocal_protocol::units::TICKS_PER_SECOND;

/// Ticks a second.
pub const TICKS: f64 = TICKS_PER_SECOND as f64;

/// Fewest ticks between two records in a plan: two more than [`SHORTEST`], for both ends are rounded to a tick.
pub const INTERVAL: u32 = SHORTEST + 2;

/// Records a second of all moving axes together. DMA takes about 0.5 µs a record on APB1: 2 million, less what idle axes
/// and the serial port's DMA take.
pub const RECORDS_PER_SECOND: f64 = 1_900_000.0;

/// Slowest speed, steps/s. Below it an interval may outlast the 25 s that the ring's arithmetic spans.
pub const SLOWEST: f64 = 0.1;

/// Largest acceleration, steps/s²: with it a span of 16 steps or more is one cubic wherever more than 10⁵ come in a second.
pub const ACCELERATION: f64 = 2e7;

/// Longest time from rest to full speed, and from none to full acceleration, s. A stretch of constant jerk spans 25 s at most.
const RAMP: f64 = 20.0;

/// Shortest time from none to full acceleration, s.
const SHORTEST_JERK: f64 = 1e-4;

/// Farthest from zero that an axis counts, steps. Backlash, overshoot and a homing run fit on top.
const FARTHEST: f64 = 1e9;

/// Pulse timing in ticks: high, low, and DIR before and after a step.
struct Timing {
    high: u32,
    low: u32,
    dir: u32,
}

const fn timing(driver: Driver) -> Timing {
    // Data sheets: Allegro A4988 rev. 8, TI SLVSA73F (DRV8825), Trinamic TMC2209 rev. 1.09; rounded up to ticks of 11.9 ns.
    match driver {
        Driver::A4988 => Timing { high: 84, low: 84, dir: 17 },
        Driver::Drv8825 => Timing { high: 160, low: 160, dir: 55 },
        Driver::Tmc2209 => Timing { high: 9, low: 9, dir: 2 },
        Driver::External => Timing { high: 420, low: 420, dir: 420 },
    }
}

/// How an axis' pulses look.
pub fn pulse(settings: &AxisSettings) -> Pulse {
    let t = timing(settings.driver);
    Pulse {
        // Longer than asked for where there is time: cables round edges off.
        high: t.high.max(20),
        setup: t.dir,
        both: settings.edges == Edges::Both,
        inverted: settings.inverted,
    }
}

/// Fastest step rate of one axis, steps/s.
pub fn fastest(settings: &AxisSettings) -> f64 {
    let t = timing(settings.driver);
    match settings.edges {
        Edges::Rising => TICKS / f64::from(INTERVAL.max(t.high.max(20) + t.low + 2)),
        Edges::Both => 2.0 * TICKS / f64::from(INTERVAL.max(2 * (t.high.max(t.low) + 1))),
    }
}

/// Records a second at a step rate.
pub fn records(settings: &AxisSettings, steps_per_second: f64) -> f64 {
    match settings.edges {
        Edges::Rising => steps_per_second,
        Edges::Both => steps_per_second / 2.0,
    }
}

/// An axis' limits in steps and ticks.
pub fn in_ticks(settings: &AxisSettings) -> Limits {
    let scale = f64::from(settings.steps_per_um.0);
    Limits {
        v: f64::from(settings.speed.0) * scale / TICKS,
        a: f64::from(settings.acceleration.0) * scale / TICKS / TICKS,
        j: f64::from(settings.jerk.0) * scale / TICKS / TICKS / TICKS,
    }
}

fn within(value: f64, low: f64, high: f64, field: Field) -> Result<(), Refusal> {
    // Written so that NaN is refused.
    if value >= low && value <= high {
        Ok(())
    } else {
        Err(Refusal::OutOfRange { field, low: low as f32, high: high as f32 })
    }
}

/// Checks every field of an axis' settings.
///
/// # Errors
/// [`Refusal::OutOfRange`] with the first field that is out of its range, or no number, which may depend on the fields before
/// it: the range of speeds follows from the scale and the driver.
pub fn check(settings: &AxisSettings) -> Result<(), Refusal> {
    let s = settings;
    let scale = f64::from(s.steps_per_um.0);
    within(scale, 0.001, 10_000.0, Field::StepsPerUm)?;
    within(f64::from(s.microsteps), 1.0, 256.0, Field::Microsteps)?;
    let (speed, acceleration, jerk) = (f64::from(s.speed.0), f64::from(s.acceleration.0), f64::from(s.jerk.0));
    within(speed, SLOWEST / scale, fastest(s) / scale, Field::Speed)?;
    within(acceleration, speed / RAMP, ACCELERATION / scale, Field::Acceleration)?;
    within(jerk, acceleration / RAMP, acceleration / SHORTEST_JERK, Field::Jerk)?;
    let um = |nm: i32| f64::from(nm) / 1000.0;
    let farthest = (FARTHEST / scale).min(2_000_000.0);
    within(um(s.low.0), -farthest, farthest, Field::Low)?;
    within(um(s.high.0), um(s.low.0) + 0.001, farthest, Field::High)?;
    within(um(s.backlash.0), 0.0, 1000.0, Field::Backlash)?;
    within(f64::from(s.settling.0), 0.0, 60_000.0, Field::Settling)?;
    within(f64::from(s.home_speed.0), SLOWEST * 10.0 / scale, speed, Field::HomeSpeed)?;
    within(um(s.home_at.0), -farthest, farthest, Field::HomeAt)
}
