//! `cargo +nightly fuzz run decoder` in protocol/: the decoder with inputs that cargo-fuzz finds.
#![no_main]

#[path = "../body.rs"]
mod body;

libfuzzer_sys::fuzz_target!(|input: &[u8]| body::run(input));
