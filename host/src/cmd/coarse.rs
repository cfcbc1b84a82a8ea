//! `parfocal calibrate coarse`: where manipulators and objective stand, seen by a stereo camera.

mod cameras;
mod folder;
mod force;
pub mod height;
mod learning;
mod pairs;
mod placing;
mod printing;
mod simulated;
mod stereo;

use super::{Connection, Output};
use clap::{ArgGroup, Args};
use parfocal::calibration::coarse::{MarkerId, StereoCamera};
use parfocal::frames::address::CameraAddress;
use parfocal::rig::Rig;
use std::path::PathBuf;

/// Coarse registration from pictures of printed markers
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("from").required(true).args([
    "pairs", "poses", "learn", "calibrate_stereo", "print_markers", "print_board",
])))]
pub struct Arguments {
    /// Folder of stereo pairs place_K_left.png, place_K_right.png, from two places or more
    #[arg(long, value_name = "DIR")]
    pairs: Option<PathBuf>,
    /// Two running cameras that take the pairs first and keep them in that folder, with where the rig's axes stood:
    /// exec:COMMAND or another camera's address; sim alone is the simulated rig's stereo camera
    #[arg(long, value_name = "LEFT RIGHT", num_args = 1..=2, requires = "pairs")]
    cameras: Vec<CameraAddress>,
    /// Places that the cameras are put to
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=50))]
    places: u32,
    /// Poses from another tracker: rows view,marker,qw,qx,qy,qz,x_mm,y_mm,z_mm
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// Learn what the markers carry from pictures of known moves, clicks, and a fine calibration: one file (see docs/coarse.md), or
    /// the folders of pairs that --cameras took, each with its now.json and clicks.json
    #[arg(long, value_name = "FILE|DIR …", num_args = 1..)]
    learn: Vec<PathBuf>,
    /// Calibrate the stereo camera from a folder of pairs of the printed board
    #[arg(long, value_name = "DIR")]
    calibrate_stereo: Option<PathBuf>,
    /// Write a sheet of markers to print, as SVG
    #[arg(long)]
    print_markers: bool,
    /// Write the calibration board to print, as SVG
    #[arg(long)]
    print_board: bool,

    /// The rig: read for stereo camera and markers; what is learned or registered is put in force there
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Leave the rig's file as it is
    #[arg(long)]
    dry_run: bool,
    /// The stereo camera: stereo.json, or a rig file with a table [stereo] [default: the rig's]
    #[arg(long, value_name = "FILE")]
    stereo: Option<PathBuf>,
    /// The markers' size: outer edge of the black border, mm [default: the rig's, or 20]
    #[arg(long, value_name = "MM")]
    tag_mm: Option<f64>,
    /// A marker of another size, as in 3=12.5; may be repeated
    #[arg(long, value_name = "ID=MM", value_parser = placing::id_and_size)]
    tag_mm_of: Vec<(u16, f64)>,
    /// The marker on the substrate [default: the rig's, or 0]
    #[arg(long, value_name = "ID")]
    substrate: Option<u16>,
    /// The pictures hold light^(1/GAMMA); estimated from the edges when not given, 1 for linear cameras
    #[arg(long)]
    gamma: Option<f64>,
    /// What was learned with --learn: gives each manipulator's registration and pipette angles [default: the rig's]
    #[arg(long, value_name = "FILE")]
    learned: Option<PathBuf>,
    /// Where the axes stood: a JSON file {"microscope_um":[x,y,z],"joints_um":{"1":[x,y,z]}} [default: now.json in the folder of pairs]
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

impl Arguments {
    /// The rig's file, if one was named.
    fn load_rig(&self) -> anyhow::Result<Option<Rig>> {
        self.rig.as_deref().map(Rig::load).transpose().map_err(Into::into)
    }

    /// Length of the markers' black border's outer edge: said, the rig's, or 20 mm.
    fn tag_mm(&self, rig: Option<&Rig>) -> f64 {
        let of_rig = rig.and_then(|rig| rig.contents().markers.as_ref());
        self.tag_mm.or(of_rig.map(|m| m.tag_mm)).unwrap_or(TAG_MM)
    }

    /// The marker on the substrate: said, the rig's, or 0.
    fn substrate(&self, rig: Option<&Rig>) -> MarkerId {
        let of_rig = rig.and_then(|rig| rig.contents().markers.as_ref());
        self.substrate.map(MarkerId).or(of_rig.map(|m| m.substrate)).unwrap_or(MarkerId(0))
    }

    /// The stereo camera: said, or the rig's.
    fn stereo(&self, rig: Option<&Rig>) -> anyhow::Result<StereoCamera> {
        match (&self.stereo, rig.and_then(|rig| rig.contents().stereo.clone())) {
            (Some(file), _) => stereo::read(file),
            (None, Some(camera)) => Ok(camera),
            (None, None) => anyhow::bail!(
                "pictures need the stereo camera: give --stereo stereo.json, or --rig FILE with a table [stereo] \
                 (--calibrate-stereo writes one)"
            ),
        }
    }

    /// Saves the rig, unless told not to; says what it did.
    fn save(&self, rig: &mut Rig) -> anyhow::Result<String> {
        let Some(path) = &self.rig else { return Ok(String::new()) };
        if self.dry_run {
            return Ok(format!("{} stays as it was (--dry-run).\n", path.display()));
        }
        rig.save(path)?;
        Ok(format!("In force in {}.\n", path.display()))
    }
}

/// The size of markers when nobody says another.
const TAG_MM: f64 = 20.0;

/// Runs `parfocal calibrate coarse`.
///
/// # Errors
/// Whatever makes pictures, poses or files unusable, as one sentence.
pub fn run(arguments: &Arguments, connection: &Connection, out: Output) -> anyhow::Result<()> {
    if arguments.print_markers || arguments.print_board {
        printing::run(arguments, out)
    } else if let Some(folder) = &arguments.calibrate_stereo {
        stereo::calibrate(arguments, folder, out)
    } else if !arguments.learn.is_empty() {
        learning::run(arguments, out)
    } else {
        placing::run(arguments, connection, out)
    }
}
