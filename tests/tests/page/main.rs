//! `parfocal serve` as its users meet it: in a browser, by scripts, by programs that mean harm, and with cameras that fail.

mod browser;
mod cameras;
mod coarse;
mod control;
mod rig_file;
mod safety;
mod scripts;
