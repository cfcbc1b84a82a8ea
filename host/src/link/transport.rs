//! Bytes to and from a board, and the clock that their deadlines are measured by.

use parfocal_protocol::units::HostTime;
use std::io;
use std::sync::OnceLock;
use std::time::Instant;

/// A connection's bytes. Implemented by serial ports, by the simulated rig and by tests that lose bytes on purpose.
pub trait Transport: Send {
    /// What the connection is called in messages: a port's name, or `sim`.
    fn name(&self) -> String;

    /// Reads what has come, or waits for something until `deadline`; 0 bytes mean that nothing came in time.
    ///
    /// # Errors
    /// The connection is gone: unplugged.
    fn read(&mut self, buffer: &mut [u8], deadline: HostTime) -> io::Result<usize>;

    /// Sends all of `bytes`.
    ///
    /// # Errors
    /// The connection is gone.
    fn write(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// The clock that deadlines are measured by: real, or the simulated rig's.
    fn now(&self) -> HostTime;

    /// Tries once to connect again after an error.
    ///
    /// # Errors
    /// It is still gone.
    fn reconnect(&mut self) -> io::Result<()>;
}

/// `now`, `millis` ms later.
pub fn later(now: HostTime, millis: u64) -> HostTime {
    HostTime(now.0.saturating_add(millis * 1000))
}

/// This computer's clock: µs since the program first asked. Ports and cameras share it, so that their times compare.
pub fn real_now() -> HostTime {
    static EPOCH: OnceLock<Instant> = OnceLock::new();
    HostTime(EPOCH.get_or_init(Instant::now).elapsed().as_micros() as u64)
}
