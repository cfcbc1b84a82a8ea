//! `parfocal calibrate`: from recorded samples to the camera's matrix, manipulators, objectives and pipettes.

mod all;
mod camera;
mod into_view;
mod latency;
mod moves;
pub mod objective;
mod pipette;
mod registration;

use super::connection::Connection;
use super::live::Recorded;
use super::{Output, coarse};
use anyhow::Context;
use clap::{Args, Subcommand};
use nalgebra::Matrix2;
use parfocal::calibration::camera::Options;
use parfocal::calibration::chain::Sensor;
use parfocal::calibration::robust::{Estimator, Solution};
use parfocal::calibration::samples::Table;
use parfocal::calibration::statistics;
use parfocal::rig::{Record, Rig};
use std::path::{Path, PathBuf};

/// Calibrate the camera, a manipulator, objectives or a pipette from samples
#[derive(Debug, Args)]
pub struct Calibrate {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Everything, with nobody at the microscope: the camera, then every manipulator
    All(all::All),
    /// The camera's matrix, from a fixed point seen from several microscope positions
    Camera(camera::Camera),
    /// A manipulator's map to ref, from its tip in focus at several of its positions
    Registration(registration::Registration),
    /// Magnification and offset of objectives, from the same points seen through each
    Objective(objective::Objective),
    /// A pipette's direction: descent and azimuth
    Pipette(pipette::Pipette),
    /// How late the camera's frames come, for sweeps with one that does not tell when it exposes
    Latency(Box<latency::Latency>),
    /// Coarse registration from pictures of printed markers
    Coarse(Box<coarse::Arguments>),
    /// A tip into the microscope's picture, by its marker
    IntoView(into_view::IntoView),
    /// The objective's height after a turn of the coarse focus knob
    ObjectiveHeight(coarse::height::Arguments),
}

/// # Errors
/// What stopped it, naming the row or key; nothing is changed then.
pub fn run(calibrate: Calibrate, connection: &Connection, out: Output) -> anyhow::Result<()> {
    match calibrate.action {
        Action::All(all) => all.run(connection, out),
        Action::Camera(camera) => camera.run(connection, out),
        Action::Registration(registration) => registration.run(connection, out),
        Action::Objective(objective) => objective.run(connection, out),
        Action::Pipette(pipette) => pipette.run(connection, out),
        Action::Latency(latency) => latency.run(connection, out),
        Action::Coarse(arguments) => coarse::run(&arguments, connection, out),
        Action::IntoView(arguments) => arguments.run(connection, out),
        Action::ObjectiveHeight(arguments) => coarse::height::run(&arguments, out),
    }
}

/// What solving samples takes.
#[derive(Debug, Args)]
struct Solving {
    /// Recorded samples: CSV with a header (columns: docs/calibrating.md); without it the rig itself is looked at, live
    #[arg(long, value_name = "FILE.csv")]
    samples: Option<PathBuf>,
    /// Largest error of a sample that counts [default: four standard deviations, from the samples]
    #[arg(long, value_name = "UM", value_parser = positive)]
    tolerance_um: Option<f64>,
    /// Seed of the random draws, and of live moves
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    seed: u64,
    /// robust, or plain: a fixed number of random draws, for comparison
    #[arg(long, default_value = "robust")]
    estimator: Estimator,
    /// Write pictures, tables and a verdict into this folder
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// The rig: read for what is calibrated already, and the result put in force there
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Leave the rig's file as it is; live: only draw the moves, and move nothing
    #[arg(long)]
    dry_run: bool,
    /// The full sensor, unbinned [default: the rig's camera]
    #[arg(long, value_name = "WxH", value_parser = sensor)]
    image_size: Option<Sensor>,
}

impl Solving {
    /// The samples' table.
    fn table(&self) -> anyhow::Result<Table> {
        let path = self.samples.as_deref().context("there are no samples: give --samples FILE.csv")?;
        Ok(Table::read(path)?)
    }

    /// Makes the report's folder before anything moves: a report that cannot be written is told at once.
    fn ready(&self) -> anyhow::Result<()> {
        self.report.as_deref().map_or(Ok(()), folder)
    }

    /// Takes what a live procedure recorded for what a person handed in.
    fn take(&mut self, recorded: Recorded) {
        self.samples = Some(recorded.samples);
        self.image_size = self.image_size.or(Some(recorded.sensor));
    }

    fn options(&self) -> Options {
        Options { tolerance_um: self.tolerance_um, seed: self.seed, estimator: self.estimator }
    }

    /// The rig's file, if one was named.
    fn rig(&self) -> anyhow::Result<Option<Rig>> {
        self.rig.as_deref().map(Rig::load).transpose().map_err(Into::into)
    }

    /// The sensor: said, or the rig's.
    fn sensor(&self, rig: Option<&Rig>) -> anyhow::Result<Sensor> {
        let of_rig = rig.and_then(|rig| rig.contents().camera.as_ref());
        let of_rig = of_rig.map(|camera| Sensor { width_px: camera.width_px, height_px: camera.height_px });
        self.image_size
            .or(of_rig)
            .context("pixels need the sensor's size: give --image-size WxH, or --rig FILE with a [camera]")
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

    /// How this was found, for the rig's file.
    fn record<const D: usize>(&self, solution: &Solution<D>, rows: Option<&[usize]>) -> Record {
        let row = |i: usize| rows.map_or(i + 1, |rows| rows[i]);
        Record {
            date: now(),
            seed: self.seed,
            samples: self.samples.as_deref().map_or_else(String::new, |path| path.display().to_string()),
            tolerance_um: solution.tolerance,
            rms_um: solution.rms(),
            residuals_um: solution.residuals.iter().map(|r| (r.norm() * 1e4).round() / 1e4).collect(),
            rejected: (0..solution.inliers.len()).filter(|&i| !solution.inliers[i]).map(row).collect(),
            certainty: statistics::certainty(solution),
        }
    }
}

/// The time, RFC 3339.
pub(super) fn now() -> String {
    humantime::format_rfc3339_seconds(std::time::SystemTime::now()).to_string()
}

/// Makes the report's folder.
fn folder(path: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(path).with_context(|| format!("cannot make the report's folder {}", path.display()))
}

/// Reads `1920x1200`.
fn sensor(text: &str) -> Result<Sensor, String> {
    let wrong = || format!("'{text}' is not a size: write the sensor's columns and rows, as in 1920x1200");
    let (w, h) = text.split_once(['x', 'X']).ok_or_else(wrong)?;
    let number = |s: &str| s.trim().parse().ok().filter(|n: &u32| *n > 1).ok_or_else(wrong);
    Ok(Sensor { width_px: number(w)?, height_px: number(h)? })
}

/// Reads a number above 0.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| v.is_finite() && *v > 0.0).ok_or_else(|| format!("'{text}' is not above 0"))
}

/// Reads `a,b,c,d`, row-major.
fn matrix(text: &str) -> Result<Matrix2<f64>, String> {
    let numbers: Vec<f64> =
        text.split(',').filter_map(|s| s.trim().parse().ok()).filter(|v: &f64| v.is_finite()).collect();
    let m = (numbers.len() == 4).then(|| Matrix2::from_row_slice(&numbers)).filter(|m| m.determinant() != 0.0);
    m.ok_or_else(|| format!("'{text}' is not a camera matrix: write a,b,c,d in µm a px, row after row, not singular"))
}

/// A matrix as nested rows.
fn rows<const R: usize, const C: usize>(m: &nalgebra::SMatrix<f64, R, C>) -> Vec<Vec<f64>> {
    m.row_iter().map(|row| row.iter().copied().collect()).collect()
}
