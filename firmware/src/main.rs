//! The board's program (STM32F429). On a PC there is nothing to run.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("parfocal-firmware runs on a board: build it with `cargo xtask firmware`");
}
