//! What a rig's parts are called: axes (`scope.x`, `m1.z`) and boards (their unique id).

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// One of the three directions of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Coordinate {
    /// First axis.
    X,
    /// Second axis.
    Y,
    /// Third axis; the microscope's focus.
    Z,
}

impl Coordinate {
    /// X, Y, Z.
    pub const ALL: [Self; 3] = [Self::X, Self::Y, Self::Z];

    /// 0, 1 or 2.
    pub fn index(self) -> usize {
        self as usize
    }
}

impl fmt::Display for Coordinate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(["x", "y", "z"][self.index()])
    }
}

/// What carries up to three axes: the microscope or a manipulator, numbered from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Device {
    /// `scope`
    Scope,
    /// `m1`, `m2`, …
    Manipulator(ManipulatorNumber),
}

/// A manipulator's number, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ManipulatorNumber(std::num::NonZeroU8);

impl ManipulatorNumber {
    /// Manipulator `n`; `None` for 0.
    pub fn new(n: u8) -> Option<Self> {
        std::num::NonZeroU8::new(n).map(Self)
    }

    /// 1, 2, …
    pub fn get(self) -> u8 {
        self.0.get()
    }
}

impl fmt::Display for ManipulatorNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "m{}", self.0)
    }
}

impl FromStr for ManipulatorNumber {
    type Err = NameError;

    /// Reads `m2` or `2`.
    fn from_str(s: &str) -> Result<Self, NameError> {
        let digits = s.strip_prefix('m').unwrap_or(s);
        digits.parse().ok().map(Self).ok_or_else(|| NameError::Manipulator(s.into()))
    }
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scope => f.write_str("scope"),
            Self::Manipulator(n) => n.fmt(f),
        }
    }
}

impl FromStr for Device {
    type Err = NameError;

    fn from_str(s: &str) -> Result<Self, NameError> {
        match s {
            "scope" => Ok(Self::Scope),
            _ if s.starts_with('m') => s.parse().map(Self::Manipulator),
            _ => Err(NameError::Device(s.into())),
        }
    }
}

/// An axis: `scope.x`, `m1.z`; `z` alone is `scope.z`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AxisName {
    /// Whose axis.
    pub device: Device,
    /// Which of its three.
    pub coordinate: Coordinate,
}

impl fmt::Display for AxisName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.device, self.coordinate)
    }
}

impl FromStr for AxisName {
    type Err = NameError;

    fn from_str(s: &str) -> Result<Self, NameError> {
        let wrong = || NameError::Axis(s.into());
        let (device, coordinate) = match s {
            "z" => ("scope", "z"),
            _ => s.split_once('.').ok_or_else(wrong)?,
        };
        let coordinate = Coordinate::ALL.into_iter().find(|c| c.to_string() == coordinate).ok_or_else(wrong)?;
        Ok(Self { device: device.parse().map_err(|_| wrong())?, coordinate })
    }
}

/// A board's unique id, as it tells it at the hello: hexadecimal, lower case.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BoardId(String);

impl BoardId {
    /// The id as hexadecimal digits.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for BoardId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for BoardId {
    type Err = NameError;

    fn from_str(s: &str) -> Result<Self, NameError> {
        if s.len() < 2 || s.len() % 2 == 1 || !s.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Err(NameError::Board(s.into()));
        }
        Ok(Self(s.to_ascii_lowercase()))
    }
}

/// A name that is none.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum NameError {
    /// Neither `scope.x` nor `m1.x`.
    #[error("'{0}' is not an axis: write scope.x, scope.y, scope.z, m1.x … or z for scope.z")]
    Axis(String),
    /// Neither `scope` nor `m1`.
    #[error("'{0}' is not a device: write scope, m1, m2 …")]
    Device(String),
    /// Not a manipulator's number.
    #[error("'{0}' is not a manipulator: write m1, m2 … (1 to 255)")]
    Manipulator(String),
    /// Not hexadecimal.
    #[error("'{0}' is not a board's unique id: an even number of hexadecimal digits, as 'parfocal setup' lists them")]
    Board(String),
}

/// Written as their text, read back from it.
macro_rules! as_text {
    ($($name:ty),*) => {$(
        impl Serialize for $name {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }
        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
            }
        }
    )*};
}
as_text!(Device, ManipulatorNumber, AxisName, BoardId);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_as_they_are_written() {
        for name in ["scope.x", "scope.z", "m1.x", "m12.y"] {
            assert_eq!(name.parse::<AxisName>().unwrap().to_string(), name);
        }
        assert_eq!("z".parse::<AxisName>().unwrap().to_string(), "scope.z");
        assert_eq!("2".parse::<ManipulatorNumber>().unwrap().to_string(), "m2");
        assert_eq!("00FFab".parse::<BoardId>().unwrap().as_str(), "00ffab");
    }

    #[test]
    fn what_is_no_name_is_refused() {
        for name in ["", "x", "scope", "scope.w", "m0.x", "m256.x", "n1.x", "m1.x.y"] {
            assert!(name.parse::<AxisName>().is_err(), "{name}");
        }
        assert!("12g4".parse::<BoardId>().is_err() && "123".parse::<BoardId>().is_err());
    }
}
