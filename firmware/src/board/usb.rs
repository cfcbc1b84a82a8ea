//! The link over USB: a CDC-ACM serial port on OTG FS (PA11, PA12).

use super::Irqs;
use super::links::{ARRIVED, USB};
use super::watchdog::{LAP, Part, check_in};
use embassy_executor::Spawner;
use embassy_futures::join::join;
use embassy_stm32::peripherals::{PA11, PA12, USB_OTG_FS};
use embassy_stm32::usb::Driver;
use embassy_stm32::{Peri, pac};
use embassy_time::{Duration, Timer, with_timeout};
use embassy_usb::class::cdc_acm::{CdcAcmClass, Receiver, Sender, State};
use embassy_usb::{Builder, UsbDevice};
use static_cell::StaticCell;

type Otg = Driver<'static, USB_OTG_FS>;

/// pid.codes' test identifiers: for devices that are not sold. The host knows a board by its answers, not by these.
const VENDOR: u16 = 0x1209;
/// See [`VENDOR`].
const PRODUCT: u16 = 0x0001;

/// Longest packet that the endpoints take.
const ENDPOINT: u16 = 64;
/// Longest packet that we send: one of 64 bytes would need an empty one behind it to end a transfer.
const PACKET: usize = ENDPOINT as usize - 1;

/// How often a packet that the host does not take is offered again, [`LAP`] apart, before it is dropped.
const OFFERS: u32 = 20;

/// The hardware of this link.
pub struct Port {
    /// The controller.
    pub otg: Peri<'static, USB_OTG_FS>,
    /// D−.
    pub minus: Peri<'static, PA11>,
    /// D+.
    pub plus: Peri<'static, PA12>,
}

/// Brings the device up and starts its tasks.
pub fn start(spawner: Spawner, port: Port) {
    static OUT: StaticCell<[u8; 256]> = StaticCell::new();
    static CONFIGURATION: StaticCell<[u8; 128]> = StaticCell::new();
    static BOS: StaticCell<[u8; 64]> = StaticCell::new();
    static CONTROL: StaticCell<[u8; 64]> = StaticCell::new();
    static STATE: StaticCell<State<'static>> = StaticCell::new();

    let mut config = embassy_stm32::usb::Config::default();
    // PA9 senses VBUS only on a self-powered device; this board lives on its ST-LINK's or its own supply and may not
    // have the jumper.
    config.vbus_detection = false;
    let driver = Otg::new_fs(port.otg, Irqs, port.plus, port.minus, OUT.init([0; 256]), config);

    let mut config = embassy_usb::Config::new(VENDOR, PRODUCT);
    config.manufacturer = Some("Parfocal");
    config.product = Some("Parfocal stage controller");
    config.serial_number = Some(embassy_stm32::uid::uid_hex());
    config.self_powered = true;
    config.max_power = 0;
    let mut builder =
        Builder::new(driver, config, CONFIGURATION.init([0; 128]), BOS.init([0; 64]), &mut [], CONTROL.init([0; 64]));
    // The endpoints look at their registers before the device has switched the controller's clock on, whoever runs first.
    pac::RCC.ahb2enr().modify(|w| w.set_usb_otg_fsen(true));
    let class = CdcAcmClass::new(&mut builder, STATE.init(State::new()), ENDPOINT);
    spawner.spawn(device(builder.build()).expect("spawned once"));
    spawner.spawn(run(class).expect("spawned once"));
}

#[embassy_executor::task]
async fn device(mut device: UsbDevice<'static, Otg>) -> ! {
    device.run().await
}

#[embassy_executor::task]
async fn run(class: CdcAcmClass<'static, Otg>) -> ! {
    let (sender, receiver) = class.split();
    join(receive(receiver), send(sender)).await.0
}

async fn receive(mut receiver: Receiver<'static, Otg>) -> ! {
    let mut packet = [0; ENDPOINT as usize];
    loop {
        check_in(Part::UsbReceiver);
        match with_timeout(LAP, receiver.read_packet(&mut packet)).await {
            Ok(Ok(n)) => {
                USB.received.write_all(&packet[..n]).await;
                ARRIVED.signal(());
            }
            // Unplugged or not configured yet: ask again in a while.
            Ok(Err(_)) => Timer::after(LAP).await,
            Err(_) => {}
        }
    }
}

async fn send(mut sender: Sender<'static, Otg>) -> ! {
    let mut packet = [0; PACKET];
    let mut offers = 0;
    loop {
        check_in(Part::UsbSender);
        let Ok(n) = with_timeout(LAP, USB.to_send.read(&mut packet)).await else { continue };
        offers = if offer(&mut sender, &packet[..n], offers).await { 0 } else { OFFERS };
    }
}

/// Offers a packet until the host takes it. False when it does not: nobody has the port open, or the cable is out; the
/// next packet is then offered only once.
async fn offer(sender: &mut Sender<'static, Otg>, packet: &[u8], already: u32) -> bool {
    let mut offers = already.min(OFFERS - 1);
    loop {
        match with_timeout(LAP, sender.write_packet(packet)).await {
            Ok(Ok(())) => return true,
            Ok(Err(_)) => {
                // Not configured: do not spin while the queue empties.
                Timer::after(Duration::from_millis(1)).await;
                return false;
            }
            Err(_) => offers += 1,
        }
        check_in(Part::UsbSender);
        if offers >= OFFERS {
            return false;
        }
    }
}
