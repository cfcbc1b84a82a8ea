//! What the live procedures share: whose rig, which camera, who finds the point, where samples go, how it is told.

use super::connection::{Bench, Connection, Purpose};
use super::{interrupt, simulated};
use anyhow::{Context, bail};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use parfocal::calibration::chain::{ChainError, Sensor};
use parfocal::focus::Measure;
use parfocal::frames::address::{CAREFUL_LATENCY, CameraAddress};
use parfocal::frames::camera::Camera;
use parfocal::procedure::{
    self, DetectorFinder, LiveRig, Parts, PointFinder, ProcedureError, Progress, Recorder, ScanFocuser, Subject,
};
use parfocal::rig::{ManipulatorNumber, Rig};
use parfocal::tip::Expect;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Options of live procedures.
#[derive(Clone, Debug, Args)]
pub struct LiveArguments {
    /// The tip detector finds the point (the default)
    #[arg(long, conflicts_with_all = ["samples", "click"])]
    detect: bool,
    /// Direction in which the tip points in the picture, degrees from x (right) towards y (down) [default: any]
    #[arg(long, value_name = "DEG", allow_hyphen_values = true, conflicts_with_all = ["samples", "click"])]
    angle_deg: Option<f64>,
    /// A person says where the point is, as x,y, in every picture
    #[arg(long, conflicts_with = "samples")]
    click: bool,
    /// Where frames come from: sim, exec:COMMAND, y4m:FILE, folder:DIR [default: sim on the simulated rig]
    #[arg(long, value_name = "SOURCE", conflicts_with = "samples")]
    camera: Option<CameraAddress>,
    /// Longest time from the begin of an exposure to its frame's arrival, for cameras that do not tell
    #[arg(long, value_name = "MS", default_value_t = CAREFUL_LATENCY.as_millis() as u64)]
    camera_latency_ms: u64,
    /// The file that samples are recorded in [default: a new one beside the rig's file]
    #[arg(long, value_name = "FILE.csv", conflicts_with = "samples")]
    record: Option<PathBuf>,
    /// Places to see the point at, besides the first few
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u16).range(1..=1000))]
    places: u16,
    /// How far from where it is expected the focus is looked for, µm
    #[arg(long, value_name = "UM", default_value_t = 60.0, value_parser = super::calibrate::positive)]
    focus_within_um: f64,
    /// The focus measure
    #[arg(long, default_value = "tenengrad")]
    measure: Measure,
}

impl LiveArguments {
    /// Places besides the first few.
    pub fn places(&self) -> usize {
        self.places.into()
    }

    /// How far from where it is expected the focus is looked for, µm.
    pub fn focus_within_um(&self) -> f64 {
        self.focus_within_um
    }
}

/// Which point is looked at: a tip, or a point by name.
#[derive(Clone, Debug, Args)]
pub struct PointArguments {
    /// The tip of this manipulator is the point, which stays where it is [default: 1]
    #[arg(long, value_name = "N", conflicts_with = "point")]
    tip: Option<ManipulatorNumber>,
    /// Another point that stays where it is, by a name; needs --click
    #[arg(long, value_name = "NAME", requires = "click")]
    point: Option<String>,
}

impl PointArguments {
    /// What is looked for.
    pub fn subject(&self) -> anyhow::Result<Subject> {
        match (&self.point, self.tip) {
            (Some(name), _) => Ok(Subject::Point(name.clone())),
            (None, Some(tip)) => Ok(Subject::Tip(tip)),
            (None, None) => Ok(Subject::Tip(ManipulatorNumber::new(1).context("there is a manipulator 1")?)),
        }
    }
}

/// What a live procedure runs in.
pub struct Room<'a> {
    /// Options.
    pub live: &'a LiveArguments,
    /// The rig's file.
    pub rig: &'a Path,
    /// Which boards; its rig is this one.
    pub connection: Connection,
    /// Seed of the moves.
    pub seed: u64,
}

/// What came of it.
pub struct Recorded {
    /// The file of samples.
    pub samples: PathBuf,
    /// The camera's sensor.
    pub sensor: Sensor,
}

impl<'a> Room<'a> {
    /// The room of a calibration.
    ///
    /// # Errors
    /// Without a rig's file there is nowhere to keep a calibration.
    pub fn new(
        live: &'a LiveArguments,
        rig: Option<&'a Path>,
        connection: &Connection,
        seed: u64,
    ) -> anyhow::Result<Self> {
        let rig = rig.context(
            "give --samples FILE.csv to solve recorded samples, or --rig FILE to calibrate live: 'parfocal setup' writes one",
        )?;
        let connection = Connection { rig: Some(rig.into()), seed, ..connection.clone() };
        Ok(Self { live, rig, connection, seed })
    }

    /// The rig's file, whose objective in use is known.
    ///
    /// # Errors
    /// What is wrong with the file; nobody said which objective is in use.
    pub fn known(&self) -> anyhow::Result<Rig> {
        let rig = Rig::load(self.rig).with_context(|| self.rig.display().to_string())?;
        if rig.contents().objective_in_use.is_none() {
            return Err(ChainError::NoObjective.into());
        }
        Ok(rig)
    }

    /// Runs a procedure and says where its samples are.
    ///
    /// # Errors
    /// What ended it; samples recorded until then stay.
    pub fn run(
        &self,
        name: &str,
        purpose: procedure::Purpose,
        procedure: &mut Procedure<'_>,
    ) -> anyhow::Result<Recorded> {
        interrupt::watch();
        let rig = self.known()?;
        let timing = super::camera::simulated_timing(self.live.camera.as_ref())?;
        let model = simulated::Model { seed: self.seed, timing, ..Default::default() };
        let Bench { mut stage, simulated } = self.connection.open(Purpose::Control, model)?;
        let mut camera = camera(self.live.camera.as_ref(), self.live.camera_latency_ms, simulated.as_ref())?;
        let mut focuser = ScanFocuser::new(self.live.measure, super::connection::fresh_session() as u16);
        let path = self.samples_path(name);
        let about = [format!("{name}: seed {}, parfocal {}", self.seed, env!("CARGO_PKG_VERSION"))];
        let mut recorder = Recorder::file(&path, purpose, &about)?;
        let mut finder: Box<dyn PointFinder> = if self.live.click {
            Box::new(super::clicking::TerminalFinder::new(path.with_extension("png")))
        } else {
            Box::new(DetectorFinder::new(Expect { angle_deg: self.live.angle_deg, ..Expect::default() }))
        };
        let bar = bar();
        let mut progress = |said: Progress| tell(&bar, said);
        let parts = Parts {
            stage: &mut stage,
            camera: camera.as_mut(),
            focuser: &mut focuser,
            rig: &rig,
            keep_on: &interrupt::keep_on,
            progress: &mut progress,
        };
        let around = Around { simulated };
        let done = LiveRig::new(parts).map_err(anyhow::Error::from).and_then(|mut live| {
            let sensor = live.window().sensor();
            procedure(&mut live, finder.as_mut(), &mut recorder, &around)?;
            Ok(sensor)
        });
        bar.finish_and_clear();
        drop(camera);
        stage.close();
        let taken = recorder.samples().len();
        match done {
            Ok(sensor) => {
                eprintln!("{taken} samples in {}", path.display());
                Ok(Recorded { samples: path, sensor })
            }
            Err(error) if taken == 0 => {
                // Nothing in it but its header.
                let _ = std::fs::remove_file(&path);
                Err(error)
            }
            Err(error) => Err(error.context(format!(
                "the old calibration stays in force; the {taken} samples taken until then are in {}",
                path.display()
            ))),
        }
    }

    fn samples_path(&self, name: &str) -> PathBuf {
        self.live.record.clone().unwrap_or_else(|| {
            let now = humantime::format_rfc3339_millis(std::time::SystemTime::now()).to_string();
            let now: String = now.chars().filter(char::is_ascii_digit).collect();
            self.rig.with_file_name(format!("{}-{now}.csv", name.replace(' ', "-")))
        })
    }
}

/// The camera that was named, or the simulated rig's.
///
/// # Errors
/// It does not open, is none that runs on, or none was named.
pub fn camera(
    named: Option<&CameraAddress>,
    latency_ms: u64,
    simulated: Option<&simulated::Handle>,
) -> anyhow::Result<Box<dyn Camera>> {
    match (named, simulated) {
        (None | Some(CameraAddress::Simulated(_)), Some(rig)) => Ok(Box::new(rig.camera())),
        (Some(address), _) => address.open(Some(Duration::from_millis(latency_ms)))?.with_context(|| {
            format!("{address} is a recording, or belongs to the simulated rig: a live procedure needs a live camera")
        }),
        (None, None) => bail!("a real rig needs a --camera: docs/cameras.md has examples"),
    }
}

/// A live procedure: it moves the rig, finds its point and records samples.
pub type Procedure<'a> =
    dyn FnMut(&mut LiveRig<'_>, &mut dyn PointFinder, &mut Recorder, &Around) -> Result<(), ProcedureError> + 'a;

/// What a procedure may need of the rig besides its axes and its camera.
pub struct Around {
    /// The simulated rig, if this is it.
    pub simulated: Option<simulated::Handle>,
}

/// A bar that says how much time is left.
pub fn bar() -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} {msg}   {elapsed}, about {eta} left");
    ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// Shows how a procedure goes.
pub fn tell(bar: &ProgressBar, said: Progress) {
    match said {
        Progress::Begins(text) => bar.suspend(|| eprintln!("{text}")),
        Progress::Focused { axis, at } => bar.set_message(format!("{axis} in focus at {:.2} µm", at.0)),
        Progress::Found { subject, pixel, confidence } => {
            bar.set_message(format!("{subject} at {:.1}, {:.1} px ({confidence:.2})", pixel.x_px, pixel.y_px));
        }
        Progress::Recorded { done, of } => {
            bar.set_length(of as u64);
            bar.set_position(done as u64);
        }
        Progress::Passed(why) => bar.suspend(|| eprintln!("passed over: {why}")),
        Progress::Warning(text) => bar.suspend(|| eprintln!("parfocal: {text}")),
    }
}
