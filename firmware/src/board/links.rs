//! The two links' bytes between the tasks that move them and the one that decides.

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::pipe::Pipe;
use embassy_sync::signal::Signal;

type Raw = CriticalSectionRawMutex;

/// Bytes that wait on one link.
pub struct Bytes {
    /// From the host.
    pub received: Pipe<Raw, 512>,
    /// To the host: whole frames.
    pub to_send: Pipe<Raw, 1024>,
}

impl Bytes {
    const fn new() -> Self {
        Self { received: Pipe::new(), to_send: Pipe::new() }
    }

    /// Queues a frame, or drops it whole when the host does not take what waits: a reply is asked for again, and a
    /// gap in the events' numbers says that one was lost.
    // A function of its own in the program, too: the emulator counts what leads to it.
    #[inline(never)]
    pub fn send(&self, frame: &[u8]) {
        if self.to_send.free_capacity() < frame.len() {
            return;
        }
        // There is room, and nobody else writes; but a pipe takes only as much at a time as lies before its end.
        let mut left = frame;
        while let Ok(n) = self.to_send.try_write(left) {
            left = &left[n..];
            if left.is_empty() {
                return;
            }
        }
    }
}

/// USB.
pub static USB: Bytes = Bytes::new();
/// USART3, which the ST-LINK offers as a serial port.
pub static SERIAL: Bytes = Bytes::new();
/// Wakes the controller when bytes came in.
pub static ARRIVED: Signal<Raw, ()> = Signal::new();
