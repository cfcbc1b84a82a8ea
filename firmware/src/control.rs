//! Bytes in, decisions, bytes out: the controller's own task.

use crate::board::links::{ARRIVED, Bytes, SERIAL, USB};
use crate::board::watchdog::{Part, check_in};
use embassy_futures::yield_now;
use embassy_time::{Duration, Instant, with_timeout};
use parfocal_firmware::controller::{Controller, Link};
use parfocal_firmware::port::{Port, Received, encode_message, encode_stranger};
use parfocal_firmware::ports::Board;
use parfocal_protocol::units::BoardTime;

/// The controller looks at the world at least this often: bounds how late a switch is seen.
const TICK: Duration = Duration::from_millis(1);

struct Connection {
    bytes: &'static Bytes,
    link: Link,
    port: Port,
    /// Whether anybody has said anything yet: events go nowhere before.
    heard: bool,
}

/// The board's clock.
pub fn now() -> BoardTime {
    BoardTime(Instant::now().as_micros())
}

/// Runs the controller for ever.
pub async fn run<B: Board>(controller: &mut Controller<B>) -> ! {
    let mut connections = [(&USB, Link(0)), (&SERIAL, Link(1))].map(|(bytes, link)| Connection {
        bytes,
        link,
        port: Port::new(),
        heard: false,
    });
    loop {
        if controller.is_thinking() {
            // Others have their turn, and it goes on.
            yield_now().await;
        } else {
            // Either bytes have come or the tick is over; both mean: look.
            let _ = with_timeout(TICK, ARRIVED.wait()).await;
        }
        check_in(Part::Control);
        for connection in &mut connections {
            connection.answer(controller);
        }
        while let Some(event) = controller.poll(now()) {
            let (frame, n) = encode_message(&event);
            for connection in connections.iter().filter(|c| c.heard) {
                connection.bytes.send(&frame[..n]);
            }
        }
    }
}

impl Connection {
    /// Takes what came in and answers it.
    fn answer<B: Board>(&mut self, controller: &mut Controller<B>) {
        let mut chunk = [0; 64];
        while let Ok(n) = self.bytes.received.try_read(&mut chunk) {
            for byte in &chunk[..n] {
                let (frame, n) = match self.port.push(*byte) {
                    None => continue,
                    Some(Received::Request(request)) => encode_message(&controller.handle(now(), self.link, &request)),
                    Some(Received::Stranger(_)) => encode_stranger(),
                };
                self.heard = true;
                self.bytes.send(&frame[..n]);
            }
        }
    }
}
