//! The board's program (STM32F429). On a PC there is nothing to run.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
mod control;

#[cfg(target_os = "none")]
#[embassy_executor::main]
async fn main(spawner: embassy_executor::Spawner) {
    board::run(spawner).await
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("parfocal-firmware runs on a board: build it with `cargo xtask firmware`");
}
