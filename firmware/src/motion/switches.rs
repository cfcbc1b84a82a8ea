//! Switches bounce: a level counts once it has stood for a while.

use parfocal_protocol::units::BoardTime;

/// How long a level must stand, µs.
pub const STANDS: u64 = 2_000;

/// One debounced input.
#[derive(Clone, Copy, Debug, Default)]
pub struct Debounce {
    level: bool,
    read: bool,
    since: BoardTime,
}

impl Debounce {
    /// Takes a reading; the debounced level.
    pub fn read(&mut self, now: BoardTime, level: bool) -> bool {
        if level != self.read {
            (self.read, self.since) = (level, now);
        }
        if self.read != self.level && now.since(self.since) >= STANDS {
            self.level = self.read;
        }
        self.level
    }

    /// Takes a level for debounced.
    pub fn force(&mut self, now: BoardTime, level: bool) {
        (self.level, self.read, self.since) = (level, level, now);
    }

    /// The debounced level.
    pub fn level(&self) -> bool {
        self.level
    }

    /// When the latest reading began.
    pub fn since(&self) -> BoardTime {
        self.since
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bouncing_is_one_press() {
        let mut input = Debounce::default();
        let mut changes = 0;
        let mut was = false;
        for ms in 0..40u64 {
            let level = match ms {
                0..10 => false,
                10..15 => ms % 2 == 0,
                15..30 => true,
                30..33 => ms % 2 == 1,
                _ => false,
            };
            let now = input.read(BoardTime(ms * 1000), level);
            changes += usize::from(now != was);
            was = now;
        }
        assert_eq!(changes, 2);
    }
}
