//! The link over USART3 (PD8, PD9), which the ST-LINK offers as a virtual serial port. Both directions by DMA.

use super::Irqs;
use super::links::{ARRIVED, SERIAL};
use super::watchdog::{LAP, Part, check_in};
use embassy_futures::join::join;
use embassy_stm32::Peri;
use embassy_stm32::mode::Async;
use embassy_stm32::peripherals::{DMA1_CH1, DMA1_CH3, PD8, PD9, USART3};
use embassy_stm32::usart::{Config, RingBufferedUartRx, Uart, UartTx};
use embassy_time::with_timeout;
use static_cell::StaticCell;

/// 42 MHz / 921,600 Bd = 45.57, sampled 8 times a bit: 0.03 % off.
const BAUD: u32 = 921_600;

/// The hardware of this link.
pub struct Port {
    /// The USART.
    pub usart: Peri<'static, USART3>,
    /// Board to host.
    pub tx: Peri<'static, PD8>,
    /// Host to board.
    pub rx: Peri<'static, PD9>,
    /// Stream 3, channel 4 (RM0090 table 42).
    pub tx_dma: Peri<'static, DMA1_CH3>,
    /// Stream 1, channel 4.
    pub rx_dma: Peri<'static, DMA1_CH1>,
}

/// Moves bytes for ever.
#[embassy_executor::task]
pub async fn run(port: Port) -> ! {
    let mut config = Config::default();
    config.baudrate = BAUD;
    let uart = match Uart::new(port.usart, port.rx, port.tx, port.tx_dma, port.rx_dma, Irqs, config) {
        Ok(uart) => uart,
        // Only a baud rate that the clock cannot make is refused: caught by the emulator's first hello.
        Err(_) => panic!("USART3 refuses its settings"),
    };
    static RING: StaticCell<[u8; 512]> = StaticCell::new();
    let (sender, receiver) = uart.split();
    let receiver = receiver.into_ring_buffered(RING.init([0; 512]));
    join(receive(receiver), send(sender)).await.0
}

async fn receive(mut uart: RingBufferedUartRx<'static>) -> ! {
    let mut buffer = [0; 64];
    loop {
        check_in(Part::SerialReceiver);
        // Noise or an overrun ends a read; the next one starts afresh, and the frame's CRC tells what was damaged.
        if let Ok(Ok(n)) = with_timeout(LAP, uart.read(&mut buffer)).await {
            SERIAL.received.write_all(&buffer[..n]).await;
            ARRIVED.signal(());
        }
    }
}

async fn send(mut uart: UartTx<'static, Async>) -> ! {
    let mut buffer = [0; 64];
    loop {
        check_in(Part::SerialSender);
        if let Ok(n) = with_timeout(LAP, SERIAL.to_send.read(&mut buffer)).await {
            // 64 bytes leave in 0.7 ms; the only error is one of receiving.
            let _ = uart.write(&buffer[..n]).await;
        }
    }
}
