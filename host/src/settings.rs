//! A board's settings as people write them: TOML with units in the keys' names.

use parfocal_protocol::settings::{AxisSettings, BoardSettings, Driver, Edges, Polarity, Side};
use parfocal_protocol::units::{
    Hertz, Micrometres, MicrometresPerSecond, MicrometresPerSecond2, MicrometresPerSecond3, Milliseconds, Nanometres,
    StepsPerMicrometre,
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use thiserror::Error;

/// Why settings could not be read.
#[derive(Debug, Error, PartialEq)]
pub enum SettingsError {
    /// Not TOML, an unknown key, or a value of the wrong kind.
    #[error("{0}")]
    Syntax(String),
    /// A length beyond ±2.1 m or not a number.
    #[error("{key} = {um}: is no length in µm that a stage can have")]
    Length {
        /// The key.
        key: &'static str,
        /// Its value.
        um: f64,
    },
    /// No such key.
    #[error("there is no setting '{key}'; there are {known}")]
    NoKey {
        /// What was asked for.
        key: String,
        /// All keys.
        known: String,
    },
}

/// Settings of a rig: axes by name, boards by their unique id.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SettingsFile {
    /// Version of these keys.
    pub schema: u32,
    /// Axes by name.
    #[serde(default)]
    pub axes: BTreeMap<String, AxisText>,
    /// Boards by unique id.
    #[serde(default)]
    pub boards: BTreeMap<String, BoardText>,
}

/// One axis' settings, in a person's units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisText {
    /// Motor (micro)steps in a µm.
    pub steps_per_um: f32,
    /// Microsteps in a full step.
    pub microsteps: u16,
    /// Fastest speed.
    pub speed_um_s: f32,
    /// Largest acceleration.
    pub acceleration_um_s2: f32,
    /// Largest jerk.
    pub jerk_um_s3: f32,
    /// Lower soft limit.
    pub low_um: f64,
    /// Upper soft limit.
    pub high_um: f64,
    /// Larger positions mean DIR low.
    pub inverted: bool,
    /// Driver timing.
    pub driver: DriverText,
    /// Which edges of STEP are steps.
    pub edges: EdgesText,
    /// Play of the screw.
    pub backlash_um: f64,
    /// Side from which every move ends.
    pub approach: SideText,
    /// Rest before an axis counts as in position.
    pub settling_ms: u32,
    /// End with the home switch.
    pub home: SideText,
    /// Speed towards it.
    pub home_speed_um_s: f32,
    /// Position of its edge.
    pub home_at_um: f64,
    /// How switches read.
    pub switches: PolarityText,
    /// Whether limit switches are wired.
    pub has_switches: bool,
    /// Whether the current is cut at rest.
    pub idle_off: bool,
}

/// A board's settings, in a person's units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoardText {
    /// Host silence after which it stops.
    pub host_timeout_ms: u32,
    /// Positions told in a second while something moves.
    pub telemetry_hz: f32,
    /// Whether an emergency-stop input is wired.
    pub has_emergency_stop: bool,
}

macro_rules! names {
    ($(#[$doc:meta])* $text:ident for $wire:ty: $($name:ident = $value:expr, $help:literal;)*) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case")]
        pub enum $text {
            $(#[doc = $help] $name,)*
        }
        impl From<$wire> for $text {
            fn from(value: $wire) -> Self {
                $(if value == $value { return Self::$name; })*
                unreachable!("every value has a name: the list above is complete, as its test shows")
            }
        }
        impl From<$text> for $wire {
            fn from(text: $text) -> Self {
                match text { $($text::$name => $value,)* }
            }
        }
    };
}

names! {
    /// A driver by name.
    DriverText for Driver:
    A4988 = Driver::A4988, "Allegro A4988.";
    Drv8825 = Driver::Drv8825, "TI DRV8825.";
    Tmc2209 = Driver::Tmc2209, "Trinamic TMC2209.";
    External = Driver::External, "Any other.";
}
names! {
    /// Edges that step.
    EdgesText for Edges:
    Rising = Edges::Rising, "The rising one.";
    Both = Edges::Both, "Both.";
}
names! {
    /// How switches read.
    PolarityText for Polarity:
    PressedHigh = Polarity::PressedHigh, "Normally closed: pressed reads high.";
    PressedLow = Polarity::PressedLow, "Normally open: pressed reads low.";
}
names! {
    /// An end of an axis, or none.
    SideText for Option<Side>:
    None = Option::None, "Neither.";
    Low = Some(Side::Low), "Towards smaller positions.";
    High = Some(Side::High), "Towards larger positions.";
}

fn nm(key: &'static str, um: f64) -> Result<Nanometres, SettingsError> {
    Micrometres(um).nanometres().ok_or(SettingsError::Length { key, um })
}

impl From<AxisSettings> for AxisText {
    fn from(s: AxisSettings) -> Self {
        let um = |at: Nanometres| at.micrometres().0;
        Self {
            steps_per_um: s.steps_per_um.0,
            microsteps: s.microsteps,
            speed_um_s: s.speed.0,
            acceleration_um_s2: s.acceleration.0,
            jerk_um_s3: s.jerk.0,
            low_um: um(s.low),
            high_um: um(s.high),
            inverted: s.inverted,
            driver: s.driver.into(),
            edges: s.edges.into(),
            backlash_um: um(s.backlash),
            approach: s.approach.into(),
            settling_ms: s.settling.0,
            home: s.home.into(),
            home_speed_um_s: s.home_speed.0,
            home_at_um: um(s.home_at),
            switches: s.switches.into(),
            has_switches: s.has_switches,
            idle_off: s.idle_off,
        }
    }
}

impl TryFrom<AxisText> for AxisSettings {
    type Error = SettingsError;

    fn try_from(t: AxisText) -> Result<Self, SettingsError> {
        Ok(Self {
            steps_per_um: StepsPerMicrometre(t.steps_per_um),
            microsteps: t.microsteps,
            speed: MicrometresPerSecond(t.speed_um_s),
            acceleration: MicrometresPerSecond2(t.acceleration_um_s2),
            jerk: MicrometresPerSecond3(t.jerk_um_s3),
            low: nm("low_um", t.low_um)?,
            high: nm("high_um", t.high_um)?,
            inverted: t.inverted,
            driver: t.driver.into(),
            edges: t.edges.into(),
            backlash: nm("backlash_um", t.backlash_um)?,
            approach: t.approach.into(),
            settling: Milliseconds(t.settling_ms),
            home: t.home.into(),
            home_speed: MicrometresPerSecond(t.home_speed_um_s),
            home_at: nm("home_at_um", t.home_at_um)?,
            switches: t.switches.into(),
            has_switches: t.has_switches,
            idle_off: t.idle_off,
        })
    }
}

impl From<BoardSettings> for BoardText {
    fn from(s: BoardSettings) -> Self {
        Self {
            host_timeout_ms: s.host_timeout.0,
            telemetry_hz: s.telemetry.0,
            has_emergency_stop: s.has_emergency_stop,
        }
    }
}

impl From<BoardText> for BoardSettings {
    fn from(t: BoardText) -> Self {
        Self {
            host_timeout: Milliseconds(t.host_timeout_ms),
            telemetry: Hertz(t.telemetry_hz),
            has_emergency_stop: t.has_emergency_stop,
        }
    }
}

/// `settings` with one key changed, the value as TOML or as a bare word.
///
/// # Errors
/// [`SettingsError::NoKey`] lists the keys; a value of the wrong kind is named with what is expected.
pub fn with_key<T: Serialize + for<'de> Deserialize<'de>>(
    settings: &T,
    key: &str,
    value: &str,
) -> Result<T, SettingsError> {
    let syntax = |e: String| SettingsError::Syntax(format!("{key} = {value}: {}", e.trim_end().replace('\n', "; ")));
    let mut table = toml::Table::try_from(settings).map_err(|e| syntax(e.to_string()))?;
    if !table.contains_key(key) {
        let known = table.keys().cloned().collect::<Vec<_>>().join(", ");
        return Err(SettingsError::NoKey { key: key.into(), known });
    }
    let quoted = format!("{key} = {value:?}");
    let parsed: toml::Table = format!("{key} = {value}")
        .parse()
        .or_else(|_| quoted.parse())
        .map_err(|e: toml::de::Error| syntax(e.to_string()))?;
    let new = parsed.get(key).cloned().unwrap_or(toml::Value::Boolean(false));
    // An integer where a fraction is meant is what people write.
    let new = match (&table[key], new) {
        (toml::Value::Float(_), toml::Value::Integer(i)) => toml::Value::Float(i as f64),
        (_, new) => new,
    };
    table.insert(key.into(), new);
    table.try_into().map_err(|e: toml::de::Error| syntax(e.message().into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_named_value_comes_back() {
        for driver in [Driver::A4988, Driver::Drv8825, Driver::Tmc2209, Driver::External] {
            assert_eq!(Driver::from(DriverText::from(driver)), driver);
        }
        for side in [None, Some(Side::Low), Some(Side::High)] {
            assert_eq!(Option::<Side>::from(SideText::from(side)), side);
        }
        for edges in [Edges::Rising, Edges::Both] {
            assert_eq!(Edges::from(EdgesText::from(edges)), edges);
        }
        for polarity in [Polarity::PressedHigh, Polarity::PressedLow] {
            assert_eq!(Polarity::from(PolarityText::from(polarity)), polarity);
        }
    }

    #[test]
    fn settings_survive_their_own_text() {
        let settings = AxisSettings { approach: Some(Side::Low), low: Nanometres(-12_345), ..Default::default() };
        let text = toml::to_string(&AxisText::from(settings)).unwrap();
        let back: AxisText = toml::from_str(&text).unwrap();
        assert_eq!(AxisSettings::try_from(back).unwrap(), settings);
    }

    #[test]
    fn one_key_changes_and_the_rest_stays() {
        let text = AxisText::from(AxisSettings::default());
        assert_eq!(with_key(&text, "speed_um_s", "250").unwrap(), AxisText { speed_um_s: 250.0, ..text.clone() });
        assert_eq!(with_key(&text, "driver", "tmc2209").unwrap().driver, DriverText::Tmc2209);
        assert!(with_key(&text, "spede", "1").unwrap_err().to_string().contains("speed_um_s"));
        assert!(with_key(&text, "driver", "tmc").unwrap_err().to_string().contains("driver = tmc"));
        assert!(with_key(&text, "inverted", "maybe").unwrap_err().to_string().contains("inverted = maybe"));
    }
}
