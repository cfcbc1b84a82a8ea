//! Older forms of records, and what they become. A form that was ever flashed stays readable for good.

use parfocal_protocol::settings::{AxisSettings, BoardSettings, Driver, Edges, Polarity, Side};
use parfocal_protocol::units::{
    AXES, MicrometresPerSecond, MicrometresPerSecond2, MicrometresPerSecond3, Milliseconds, Nanometres,
    StepsPerMicrometre,
};
use serde::Deserialize;
use serde::de::DeserializeOwned;

/// The form in which this firmware writes records.
pub const VERSION: u8 = 1;

/// Something that is kept, in whatever form it was written.
pub trait Record: Sized {
    /// Reads a record of form `version`; `None` when it is of a newer form, or not of this kind at all.
    fn read(version: u8, bytes: &[u8]) -> Option<Self>;
}

/// All of the bytes, as one value.
fn whole<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    match postcard::take_from_bytes(bytes) {
        Ok((value, [])) => Some(value),
        _ => None,
    }
}

impl Record for AxisSettings {
    fn read(version: u8, bytes: &[u8]) -> Option<Self> {
        match version {
            0 => whole::<Axis0>(bytes).map(Into::into),
            VERSION => whole(bytes),
            _ => None,
        }
    }
}

impl Record for BoardSettings {
    fn read(version: u8, bytes: &[u8]) -> Option<Self> {
        (version <= VERSION).then(|| whole(bytes)).flatten()
    }
}

/// Steps of every axis at rest, and whether they were known.
pub type Position = Option<[(i32, bool); AXES]>;

impl Record for Position {
    fn read(version: u8, bytes: &[u8]) -> Option<Self> {
        (version <= VERSION).then(|| whole(bytes)).flatten()
    }
}

/// An axis' settings of form 0: microsteps were not a setting yet, and 16 by assumption.
#[derive(Deserialize)]
#[cfg_attr(test, derive(serde::Serialize))]
pub struct Axis0 {
    pub steps_per_um: StepsPerMicrometre,
    pub speed: MicrometresPerSecond,
    pub acceleration: MicrometresPerSecond2,
    pub jerk: MicrometresPerSecond3,
    pub low: Nanometres,
    pub high: Nanometres,
    pub inverted: bool,
    pub driver: Driver,
    pub edges: Edges,
    pub backlash: Nanometres,
    pub approach: Option<Side>,
    pub settling: Milliseconds,
    pub home: Option<Side>,
    pub home_speed: MicrometresPerSecond,
    pub home_at: Nanometres,
    pub switches: Polarity,
    pub has_switches: bool,
    pub idle_off: bool,
}

impl From<Axis0> for AxisSettings {
    fn from(old: Axis0) -> Self {
        Self {
            steps_per_um: old.steps_per_um,
            microsteps: 16,
            speed: old.speed,
            acceleration: old.acceleration,
            jerk: old.jerk,
            low: old.low,
            high: old.high,
            inverted: old.inverted,
            driver: old.driver,
            edges: old.edges,
            backlash: old.backlash,
            approach: old.approach,
            settling: old.settling,
            home: old.home,
            home_speed: old.home_speed,
            home_at: old.home_at,
            switches: old.switches,
            has_switches: old.has_switches,
            idle_off: old.idle_off,
        }
    }
}
