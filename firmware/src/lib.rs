//! Everything a Parfocal board decides: sans-IO, deterministic, without allocation.
#![no_std]
