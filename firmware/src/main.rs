#![cfg_attr(target_os = "none", no_std, no_main)]
#[cfg(target_os = "none")]
use defmt_rtt as _;
#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! { loop {} }
#[cfg(target_os = "none")]
#[embassy_executor::main]
async fn main(_s: embassy_executor::Spawner) {
    let _p = embassy_stm32::init(Default::default());
}
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("parfocal-firmware runs on a board: build it with `cargo xtask firmware`");
}
