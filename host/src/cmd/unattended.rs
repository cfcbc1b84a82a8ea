//! A rig, its camera and the tip detector, for what runs with nobody at the microscope.

use super::calibrate::objective::turn;
use super::connection::{Bench, Connection, Purpose};
use super::live::{Around, bar, camera, tell};
use super::{interrupt, simulated};
use anyhow::Context;
use clap::Args;
use parfocal::autonomous::{AutoError, DetectorEyes, Turret, Work};
use parfocal::calibration::chain::ChainError;
use parfocal::focus::Measure;
use parfocal::frames::address::{CAREFUL_LATENCY, CameraAddress};
use parfocal::frames::camera::Camera;
use parfocal::procedure::{DetectorFinder, ScanFocuser};
use parfocal::rig::Rig;
use parfocal::stage::Stage;
use parfocal::tip::Expect;
use std::time::Duration;

/// How tips are seen and focused.
#[derive(Clone, Debug, Args)]
pub struct Eyesight {
    /// Where frames come from: sim, exec:COMMAND … [default: sim on the simulated rig]
    #[arg(long, value_name = "SOURCE")]
    camera: Option<CameraAddress>,
    /// Longest time from the begin of an exposure to its frame's arrival, for cameras that do not tell
    #[arg(long, value_name = "MS", default_value_t = CAREFUL_LATENCY.as_millis() as u64)]
    camera_latency_ms: u64,
    /// How far above and below the present height tips are looked for at first, µm
    #[arg(long, value_name = "UM", default_value_t = 60.0, value_parser = super::calibrate::positive)]
    pub reach_um: f64,
    /// The focus measure
    #[arg(long, default_value = "tenengrad")]
    measure: Measure,
    /// How sure the detector has to be, 0 to 1
    #[arg(long, value_name = "0..1", default_value_t = Expect::default().confidence)]
    confidence: f64,
    /// Size of a pixel at the sample, µm: what a tip looks like [default: the rig's, else 0.32]
    #[arg(long, value_name = "UM", value_parser = super::calibrate::positive)]
    pixel_um: Option<f64>,
}

/// An opened rig with eyes.
pub struct Unattended {
    stage: Stage,
    camera: Box<dyn Camera>,
    focuser: ScanFocuser,
    eyes: DetectorEyes,
    around: Around,
}

impl Unattended {
    /// Connects to the rig and its camera.
    ///
    /// # Errors
    /// Nobody said which objective is in use; a port or the camera does not open.
    pub fn open(connection: &Connection, eyesight: &Eyesight, rig: &Rig) -> anyhow::Result<Self> {
        interrupt::watch();
        if rig.contents().objective_in_use.is_none() {
            return Err(ChainError::NoObjective.into());
        }
        let model = simulated::Model { seed: connection.seed, ..Default::default() };
        let Bench { stage, simulated } = connection.open(Purpose::Control, model)?;
        let camera = camera(eyesight.camera.as_ref(), eyesight.camera_latency_ms, simulated.as_ref())?;
        let focuser = ScanFocuser::new(eyesight.measure, super::connection::fresh_session() as u16);
        let of_rig = rig.contents().camera.as_ref().and_then(|camera| camera.calibration.as_ref());
        let of_rig = of_rig.map(|c| c.matrix_um_per_px[0][0].hypot(c.matrix_um_per_px[1][0]));
        let known = Expect { confidence: eyesight.confidence, ..Expect::default() };
        let expect = Expect { pixel_um: eyesight.pixel_um.or(of_rig).unwrap_or(known.pixel_um), ..known };
        Ok(Self { stage, camera, focuser, eyes: DetectorEyes { expect }, around: Around { simulated } })
    }

    /// The rig's clock.
    pub fn now(&self) -> Duration {
        Duration::from_micros(self.stage.now().0)
    }

    /// Does something with it, showing how it goes. Tips are brought into view first `through` these objectives, the weakest first, if any.
    ///
    /// # Errors
    /// What stopped it.
    pub fn work<T>(
        &mut self,
        through: &[String],
        what: &mut dyn FnMut(&mut Work<'_>) -> Result<T, AutoError>,
    ) -> anyhow::Result<T> {
        let bar = bar();
        let mut progress = |said| tell(&bar, said);
        let around = &self.around;
        let mut change = |name: &str| turn(name, around);
        let mut finder = DetectorFinder::new(self.eyes.expect);
        let turret = (!through.is_empty()).then_some(Turret { through, change: &mut change, finder: &mut finder });
        let mut work = Work {
            stage: &mut self.stage,
            camera: self.camera.as_mut(),
            focuser: &mut self.focuser,
            eyes: &mut self.eyes,
            keep_on: &interrupt::keep_on,
            progress: &mut progress,
            turret,
        };
        let done = what(&mut work);
        bar.finish_and_clear();
        done.context("the run ended early")
    }

    /// Ends the sessions.
    pub fn close(self) {
        drop(self.camera);
        self.stage.close();
    }
}
