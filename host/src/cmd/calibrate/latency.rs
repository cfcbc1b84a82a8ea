//! `parfocal calibrate latency`: how late a camera's frames come, by sweeps in both directions at two speeds.

use crate::cmd::camera::{CameraAddress, Region, sharpest_of, simulated_region};
use crate::cmd::connection::{Bench, Connection, Purpose, shown};
use crate::cmd::{Output, interrupt, simulated};
use anyhow::{Context, bail};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use parfocal::autofocus::latency::{Calibrated, LatencyPlan, measure};
use parfocal::autofocus::{CameraSource, Plan, Progress, focus};
use parfocal::focus::Measure;
use parfocal::frames::camera::Camera;
use parfocal::link::explain::scan_refusal;
use parfocal::link::transport::later;
use parfocal::picture::Roi;
use parfocal::rig::{self, AxisName, CameraLatency, Rig};
use parfocal_protocol::autofocus::Outcome;
use parfocal_protocol::units::{Micrometres, MicrometresPerSecond};

/// What `calibrate latency` takes.
#[derive(Debug, Args)]
pub struct Latency {
    /// The axis that sweeps
    #[arg(long, default_value = "scope.z", value_name = "AXIS")]
    axis: AxisName,
    /// The camera, as of `parfocal autofocus`
    #[arg(long, value_name = "SOURCE", default_value = "sim")]
    camera: CameraAddress,
    /// The focus measure: one whose curve has a single peak here
    #[arg(long, default_value = "tenengrad")]
    measure: Measure,
    /// The region whose focus matters, px
    #[arg(long, value_name = "X,Y,W,H|auto|all")]
    roi: Option<Region>,
    /// How far to both sides of the focus the sweeps go
    #[arg(long, value_name = "UM", default_value_t = 40.0, value_parser = super::positive)]
    reach_um: f64,
    /// The lower speed
    #[arg(long, value_name = "UM_PER_S", default_value_t = 40.0)]
    slow_um_s: f32,
    /// The higher speed
    #[arg(long, value_name = "UM_PER_S", default_value_t = 100.0)]
    fast_um_s: f32,
    /// How often all four sweeps are made
    #[arg(long, default_value_t = 3)]
    repeats: u32,
    /// Tell the board the backlash that was found, on top of what it knows
    #[arg(long)]
    set_backlash: bool,
    /// Leave the rig's file as it is
    #[arg(long)]
    dry_run: bool,
}

impl Latency {
    /// Runs the command.
    ///
    /// # Errors
    /// What stopped it; the rig's file is not changed then.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        interrupt::watch();
        let mut file = connection.rig.as_deref().map(Rig::load).transpose()?;
        let timing = if let CameraAddress::Simulated(timing) = self.camera { Some(timing) } else { None };
        let model = simulated::Model { seed: connection.seed, timing, ..Default::default() };
        let mut bench = connection.open(Purpose::Control, model)?;
        let (mut camera, roi) = self.camera(&bench)?;
        let size = camera.next_frame(later(bench.stage.now(), 2_000))?.context("the camera gave no frame")?.picture;
        let mut source = CameraSource::new(camera, roi, self.measure, None);
        let style = ProgressStyle::with_template("{spinner} {pos:>5} frames   {msg}   {elapsed}");
        let bar = ProgressBar::new_spinner().with_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
        let mut show = |told: Progress| {
            bar.inc(1);
            match told {
                Progress::Sample(sample) => bar.set_message(format!("z {:9.2} µm", sample.z.0)),
                Progress::Fault(fault) => bar.set_message(format!("no value: {fault:?}")),
                Progress::Pacing { doubt_us, .. } => {
                    bar.set_message(format!("learning the camera's pace: known to {:.2} ms", doubt_us / 1000.0));
                }
            }
        };
        let plan = Plan::new(self.axis);
        let peak = focus(&mut bench.stage, &mut source, &plan, &mut show, &interrupt::keep_on)?;
        if let Outcome::Refused(why) = peak.report.outcome {
            bail!("there is nothing to sweep over, the focus before it was refused: {}", scan_refusal(why));
        }
        let plan = LatencyPlan {
            focus: plan,
            peak: peak.report.end.micrometres(),
            reach: Micrometres(self.reach_um),
            slow: MicrometresPerSecond(self.slow_um_s),
            fast: MicrometresPerSecond(self.fast_um_s),
            repeats: self.repeats,
        };
        let found = measure(&mut bench.stage, &mut source, &plan, &mut show, &interrupt::keep_on);
        bar.finish_and_clear();
        let found = found?;
        if self.set_backlash {
            let mut settings = bench.stage.settings(self.axis)?;
            let all = settings.backlash.micrometres().0 + found.backlash_um.max(0.0);
            settings.backlash = Micrometres(all).nanometres().context("such a backlash no screw has")?;
            bench.stage.set_settings(self.axis, settings)?;
        }
        bench.stage.close();
        let mut text = self.text(&found);
        if let (Some(file), Some(path), false) = (&mut file, &connection.rig, found.told || self.dry_run) {
            let camera = file.contents_mut().camera.get_or_insert(rig::Camera {
                width_px: u32::try_from(size.width)?,
                height_px: u32::try_from(size.height)?,
                crop_px: None,
                binning: 1,
                calibration: None,
                latency: None,
            });
            camera.latency = Some(entry(&found));
            file.save(path)?;
            text += &format!("In force in {}.\n", shown(path));
        } else if !found.told {
            text += "Nothing was kept: --rig FILE says where.\n";
        }
        out.result(&text, &json(&found))
    }

    /// The camera and the region of its pictures.
    fn camera(&self, bench: &Bench) -> anyhow::Result<(Box<dyn Camera>, Option<Roi>)> {
        match (&self.camera, &bench.simulated) {
            (CameraAddress::Stack(_) | CameraAddress::Curve(_), _) => {
                bail!("a recording has no latency: name a live camera, as in --camera \"sim?stamps=arrival\"")
            }
            (CameraAddress::Simulated(_), Some(rig)) => Ok((Box::new(rig.camera()), simulated_region(rig, self.roi)?)),
            (CameraAddress::Simulated(_), None) => bail!("a real board needs a --camera: docs/cameras.md has examples"),
            (CameraAddress::Live(_), Some(_)) => {
                bail!("a real camera does not see the simulated rig: name the board with --port or --rig")
            }
            (CameraAddress::Live(address), None) => {
                let camera = address.open(None)?;
                let mut camera = camera.with_context(|| format!("{address} is no camera of a real rig"))?;
                let roi = match self.roi {
                    Some(Region::Drawn(roi)) => Some(roi),
                    Some(Region::All) => None,
                    None | Some(Region::Sharpest) => sharpest_of(camera.as_mut(), bench.stage.now())?,
                };
                Ok((camera, roi))
            }
        }
    }

    fn text(&self, found: &Calibrated) -> String {
        let Calibrated { latency, error_us, backlash_um, backlash_error_um, told, frames, .. } = found;
        let (late, error) = (latency.late_us / 1000.0, error_us / 1000.0);
        let mut text = if *told {
            format!(
                "The camera tells when it exposes; by the sweeps it is right to {late:.2} ± {error:.2} ms. Nothing to keep.\n"
            )
        } else {
            format!(
                "Frames come {late:.2} ± {error:.2} ms after the middle of their exposure ({} arrivals, {:.2} frames/s, pace learnt from {frames} frames).\n",
                if latency.edge == Default::default() { "the earliest" } else { "the latest" },
                1e6 / latency.period_us,
            )
        };
        text += &format!("Backlash that the board does not know of: {backlash_um:.2} ± {backlash_error_um:.2} µm");
        let worth = *backlash_um > 0.1 && *backlash_um > 3.0 * backlash_error_um;
        text += match (worth, self.set_backlash) {
            (_, true) => "; the board knows it now, `parfocal settings save` keeps it.\n",
            (true, false) => ": --set-backlash tells the board.\n",
            (false, false) => ".\n",
        };
        text
    }
}

fn entry(found: &Calibrated) -> CameraLatency {
    let rounded = |us: f64| us.round() / 1000.0;
    CameraLatency {
        latency_ms: rounded(found.latency.late_us),
        error_ms: rounded(found.error_us),
        period_ms: rounded(found.latency.period_us),
        edge: found.latency.edge,
        date: super::now(),
    }
}

fn json(found: &Calibrated) -> serde_json::Value {
    let sweeps: Vec<_> = found
        .sweeps
        .iter()
        .map(|s| {
            serde_json::json!({
                "speed_um_s": s.speed.0, "up_um": s.up.micrometres().0, "down_um": s.down.micrometres().0,
            })
        })
        .collect();
    serde_json::json!({
        "latency_ms": found.latency.late_us / 1000.0,
        "error_ms": found.error_us / 1000.0,
        "period_ms": found.latency.period_us / 1000.0,
        "edge": found.latency.edge,
        "exposure_told": found.told,
        "backlash_um": found.backlash_um,
        "backlash_error_um": found.backlash_error_um,
        "frames": found.frames,
        "sweeps": sweeps,
    })
}
