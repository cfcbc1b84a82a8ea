//! Who may move things: one operator at a time, by a key that nobody else can guess. Everybody may watch, and stop.

use crate::link::transport::later;
use parfocal_protocol::units::HostTime;
use thiserror::Error;

/// An operator who is not heard of for this long can be replaced by anyone who asks, ms.
const LEASE_MS: u64 = 10_000;
/// Left of the lease when the operator's page goes away: time to load it again, ms.
const RELOAD_MS: u64 = 3_000;

/// An operator's key: 128 random bits in hexadecimal digits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Key(String);

impl Key {
    /// A key of 128 random bits.
    pub fn random() -> Self {
        Self(format!("{:032x}", rand::random::<u128>()))
    }

    /// What a request carries, in its own header.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// Why somebody may not move things.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum Denied {
    /// Nobody asked for control with this key, or another operator took it.
    #[error("you do not have control: take it first (the button 'Take control', or POST /api/control)")]
    NotOperator,
    /// Somebody else has control.
    #[error("{0} has control: watch, or take control by force, which stops what moves")]
    Held(String),
}

#[derive(Debug)]
struct Operator {
    key: Key,
    name: String,
    until: HostTime,
}

/// Who has control.
#[derive(Debug, Default)]
pub struct Control {
    operator: Option<Operator>,
}

impl Control {
    /// Somebody called `name` asks for control and gets `key`. Whether another operator lost it by this.
    ///
    /// # Errors
    /// [`Denied::Held`] when another operator is active and `force` was not said.
    pub fn take(&mut self, now: HostTime, key: Key, name: &str, force: bool) -> Result<bool, Denied> {
        let lost = match &self.operator {
            Some(operator) if now < operator.until && !force => return Err(Denied::Held(operator.name.clone())),
            other => other.is_some(),
        };
        self.operator = Some(Operator { key, name: name.into(), until: later(now, LEASE_MS) });
        Ok(lost)
    }

    /// Whether a key is the operator's; hearing of it keeps control.
    ///
    /// # Errors
    /// [`Denied`].
    pub fn check(&mut self, now: HostTime, key: &str) -> Result<(), Denied> {
        match &mut self.operator {
            Some(operator) if same(&operator.key.0, key) => {
                operator.until = later(now, LEASE_MS);
                Ok(())
            }
            Some(operator) if now < operator.until => Err(Denied::Held(operator.name.clone())),
            _ => Err(Denied::NotOperator),
        }
    }

    /// The operator gives control back.
    pub fn release(&mut self, key: &str) -> bool {
        let own = self.operator.as_ref().is_some_and(|operator| same(&operator.key.0, key));
        if own {
            self.operator = None;
        }
        own
    }

    /// The operator's page went away: somebody else need not wait for long.
    pub fn left(&mut self, now: HostTime, key: &str) {
        if let Some(operator) = self.operator.as_mut().filter(|o| same(&o.key.0, key)) {
            operator.until = operator.until.min(later(now, RELOAD_MS));
        }
    }

    /// The operator's name, while active.
    pub fn operator(&self, now: HostTime) -> Option<&str> {
        self.operator.as_ref().filter(|o| now < o.until).map(|o| o.name.as_str())
    }

    /// Whether a key is the operator's, without renewing anything.
    pub fn is(&self, key: &str) -> bool {
        self.operator.as_ref().is_some_and(|o| same(&o.key.0, key))
    }
}

/// Whether two secrets are the same, in a time that tells nothing about where they differ.
pub fn same(a: &str, b: &str) -> bool {
    let (a, b) = (a.as_bytes(), b.as_bytes());
    let differ = a.iter().zip(b.iter().chain(std::iter::repeat(&0))).fold(0, |d, (x, y)| d | (x ^ y));
    differ == 0 && a.len() == b.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_operator_has_control_until_gone_or_forced_out() {
        let mut control = Control::default();
        let (ann, bob) = (Key::random(), Key::random());
        let at = |s: u64| HostTime(s * 1_000_000);
        assert_eq!(control.check(at(0), ann.as_str()), Err(Denied::NotOperator));
        assert_eq!(control.take(at(0), ann.clone(), "Ann", false), Ok(false));
        assert_eq!(control.take(at(9), bob.clone(), "Bob", false), Err(Denied::Held("Ann".into())));
        assert_eq!(control.check(at(9), bob.as_str()), Err(Denied::Held("Ann".into())));
        assert_eq!(control.check(at(9), ann.as_str()), Ok(()));
        // Renewed at 9 s: until 19 s.
        assert!(control.take(at(18), bob.clone(), "Bob", false).is_err());
        assert_eq!(control.take(at(18), bob.clone(), "Bob", true), Ok(true));
        assert_eq!(control.check(at(18), ann.as_str()), Err(Denied::Held("Bob".into())));
        control.left(at(20), bob.as_str());
        assert_eq!(control.operator(at(22)), Some("Bob"));
        assert_eq!(control.operator(at(23)), None);
        assert_eq!(control.check(at(24), bob.as_str()), Ok(()), "a page that was loaded again goes on");
        assert!(control.release(bob.as_str()) && !control.release(bob.as_str()));
    }

    #[test]
    fn secrets_are_compared_whole() {
        assert!(same("abc", "abc") && same("", ""));
        for other in ["", "ab", "abd", "abcd", "xbc", "abc\0"] {
            assert!(!same("abc", other) && !same(other, "abc"), "{other}");
        }
    }
}
