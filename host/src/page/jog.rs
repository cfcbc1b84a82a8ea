//! The dead man's handle: a jog goes on only while somebody keeps asking for it.

use crate::link::transport::later;
use crate::rig::AxisName;
use parfocal_protocol::units::{HostTime, MicrometresPerSecond};
use std::collections::BTreeMap;

/// A jog that is not asked for again within this time ends, ms. Browsers ask every 60 ms while a key or button is held.
pub const RENEW_MS: u64 = 150;

/// The jogs under way.
#[derive(Debug, Default)]
pub struct Watchdog {
    held: BTreeMap<AxisName, (MicrometresPerSecond, HostTime)>,
}

impl Watchdog {
    /// Somebody asks for a jog, or asks again. Whether the axis must be told: the speed is new.
    pub fn ask(&mut self, now: HostTime, axis: AxisName, speed: MicrometresPerSecond) -> bool {
        if speed.0 == 0.0 {
            return self.held.remove(&axis).is_some();
        }
        let before = self.held.insert(axis, (speed, later(now, RENEW_MS)));
        before.is_none_or(|(was, _)| was != speed)
    }

    /// Axes whose jog nobody asked for any more: they are to be stopped, and are forgotten.
    pub fn expired(&mut self, now: HostTime) -> Vec<AxisName> {
        let late: Vec<_> = self.held.iter().filter(|(_, (_, until))| now >= *until).map(|(axis, _)| *axis).collect();
        self.held.retain(|axis, _| !late.contains(axis));
        late
    }

    /// Lets go of everything: these axes are to be stopped.
    pub fn let_go(&mut self) -> Vec<AxisName> {
        std::mem::take(&mut self.held).into_keys().collect()
    }

    /// Whether anything jogs.
    pub fn any(&self) -> bool {
        !self.held.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FAST: MicrometresPerSecond = MicrometresPerSecond(500.0);

    #[test]
    fn a_jog_ends_when_nobody_asks_again() {
        let (mut dog, axis) = (Watchdog::default(), "scope.x".parse().unwrap());
        let at = |ms: u64| HostTime(ms * 1000);
        assert!(dog.ask(at(0), axis, FAST));
        assert!(!dog.ask(at(100), axis, FAST), "asked again: nothing new for the axis");
        assert!(dog.ask(at(110), axis, MicrometresPerSecond(-500.0)));
        assert_eq!(dog.expired(at(259)), []);
        assert_eq!(dog.expired(at(260)), [axis]);
        assert_eq!(dog.expired(at(261)), [], "told once");
        assert!(!dog.any());
    }

    #[test]
    fn letting_go_ends_it_at_once() {
        let (mut dog, axis) = (Watchdog::default(), "m1.z".parse().unwrap());
        dog.ask(HostTime(0), axis, FAST);
        assert!(dog.ask(HostTime(1), axis, MicrometresPerSecond(0.0)));
        assert!(!dog.ask(HostTime(1), axis, MicrometresPerSecond(0.0)));
        dog.ask(HostTime(0), axis, FAST);
        assert_eq!(dog.let_go(), [axis]);
    }
}
