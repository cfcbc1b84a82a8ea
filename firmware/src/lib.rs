//! Everything a Parfocal board decides: sans-IO, deterministic, without allocation. It runs on a PC as it runs on the
//! board: time is an argument, the hardware is the trait [`ports::Board`].
#![no_std]

pub mod autofocus;
pub mod controller;
mod focusing;
pub mod keeping;
pub mod motion;
mod parking;
pub mod port;
pub mod ports;
mod sessions;
