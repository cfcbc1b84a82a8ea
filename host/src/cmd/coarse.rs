//! `parfocal calibrate coarse`: where manipulators and objective stand, seen by a stereo camera.

pub mod height;
mod learning;
mod pairs;
mod placing;
mod printing;
mod stereo;

use super::Output;
use clap::{ArgGroup, Args};
use std::path::PathBuf;

/// Coarse registration from pictures of printed markers
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("from").required(true).args([
    "pairs", "poses", "learn", "calibrate_stereo", "print_markers", "print_board",
])))]
pub struct Arguments {
    /// Folder of stereo pairs place_K_left.png, place_K_right.png, from two places or more
    #[arg(long, value_name = "DIR", requires = "stereo")]
    pairs: Option<PathBuf>,
    /// Poses from another tracker: rows view,marker,qw,qx,qy,qz,x_mm,y_mm,z_mm
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// Learn what the markers carry from pictures of known moves, clicks, and a fine calibration (see docs/coarse.md)
    #[arg(long, value_name = "FILE", requires = "stereo")]
    learn: Option<PathBuf>,
    /// Calibrate the stereo camera from a folder of pairs of the printed board
    #[arg(long, value_name = "DIR")]
    calibrate_stereo: Option<PathBuf>,
    /// Write a sheet of markers to print, as SVG
    #[arg(long)]
    print_markers: bool,
    /// Write the calibration board to print, as SVG
    #[arg(long)]
    print_board: bool,

    /// The stereo camera: stereo.json, or a rig file with a table [stereo]
    #[arg(long, value_name = "FILE")]
    stereo: Option<PathBuf>,
    /// The markers' size: outer edge of the black border, mm
    #[arg(long, value_name = "MM", default_value_t = 20.0)]
    tag_mm: f64,
    /// A marker of another size, as in 3=12.5; may be repeated
    #[arg(long, value_name = "ID=MM", value_parser = placing::id_and_size)]
    tag_mm_of: Vec<(u16, f64)>,
    /// The marker on the substrate
    #[arg(long, value_name = "ID", default_value_t = 0)]
    substrate: u16,
    /// The pictures hold light^(1/GAMMA); estimated from the edges when not given, 1 for linear cameras
    #[arg(long)]
    gamma: Option<f64>,
    /// What was learned with --learn: gives each manipulator's registration and pipette angles
    #[arg(long, value_name = "FILE", requires = "now")]
    learned: Option<PathBuf>,
    /// Where the axes stood: a JSON file {"microscope_um":[x,y,z],"joints_um":{"1":[x,y,z]}}
    #[arg(long, value_name = "FILE")]
    now: Option<PathBuf>,
    /// Standard deviation of the other tracker's positions
    #[arg(long, value_name = "MM", default_value_t = 0.1)]
    tracker_mm: f64,
    /// Standard deviation of the other tracker's rotations
    #[arg(long, value_name = "DEG", default_value_t = 0.1)]
    tracker_deg: f64,
    /// Markers to print, as in 0-3,7
    #[arg(long, value_name = "IDS", default_value = "0-3", value_parser = printing::ids)]
    ids: printing::Ids,
    /// Columns and rows of the calibration board
    #[arg(long, value_name = "COLSxROWS", default_value = "6x8", value_parser = printing::columns_and_rows)]
    board: (u16, u16),
    /// The board's first marker
    #[arg(long, value_name = "ID", default_value_t = 500)]
    board_first: u16,
    /// Size of the board's markers, mm
    #[arg(long, value_name = "MM", default_value_t = 22.0)]
    board_tag_mm: f64,
    /// Between the black borders of the board's markers, mm
    #[arg(long, value_name = "MM", default_value_t = 8.0)]
    board_gap_mm: f64,
    /// File to write instead of printing on stdout
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Runs `parfocal calibrate coarse`.
///
/// # Errors
/// Whatever makes pictures, poses or files unusable, as one sentence.
pub fn run(arguments: &Arguments, out: Output) -> anyhow::Result<()> {
    if arguments.print_markers || arguments.print_board {
        printing::run(arguments, out)
    } else if let Some(folder) = &arguments.calibrate_stereo {
        stereo::calibrate(arguments, folder, out)
    } else if let Some(file) = &arguments.learn {
        learning::run(arguments, file, out)
    } else {
        placing::run(arguments, out)
    }
}
