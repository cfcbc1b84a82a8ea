//! `parfocal autofocus`: brings an axis into focus and says how.

use super::camera::{CameraAddress, Recorded, Region, sharpest_of, simulated_region};
use super::connection::{Bench, Connection, Purpose};
use super::{Output, interrupt, simulated};
use anyhow::{Context, bail};
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use parfocal::autofocus::source::FocusSource;
use parfocal::autofocus::{CameraSource, Plan, Progress, Sample, Scanned, Span, focus, plot};
use parfocal::focus::Measure;
use parfocal::frames::address::CAREFUL_LATENCY;
use parfocal::frames::camera::Camera;
use parfocal::link::explain::scan_refusal;
use parfocal::rig::AxisName;
use parfocal_protocol::autofocus::{Mode, Outcome, Strategy, Subject};
use parfocal_protocol::units::{Micrometres, MicrometresPerSecond, Nanometres};
use serde::Serialize;
use std::path::PathBuf;
use std::str::FromStr;

/// Bring an axis into focus
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The axis that moves: the lens, or a manipulator's z
    #[arg(long, default_value = "scope.z", value_name = "AXIS")]
    axis: AxisName,
    /// Where frames come from: sim[?fps=N&exposure_ms=N&delay_ms=LO..HI&stamps=exposure|arrival], stack:DIR,
    /// curve:FILE.csv[?noise=REL&seed=N]; of a real rig exec:COMMAND, y4m:FILE or folder:DIR
    #[arg(long, value_name = "SOURCE")]
    camera: Option<CameraAddress>,
    /// Where to begin, µm on the axis [default: where it is; a stack's or curve's middle]
    #[arg(long, value_name = "UM", allow_hyphen_values = true)]
    start: Option<f64>,
    /// How far to look, µm relative to the start, clipped to the soft limits [default: those limits, at most 500 µm away]
    #[arg(long, value_name = "LO..HI", allow_hyphen_values = true)]
    range: Option<Range>,
    /// The focus measure: `parfocal focus compare` helps to choose
    #[arg(long, default_value = "tenengrad")]
    measure: Measure,
    /// The region whose focus matters, px; auto: the sharpest texture where the scan begins; all: the whole frame
    /// [default: auto; a recorded stack's own, or all of it]
    #[arg(long, value_name = "X,Y,W,H|auto|all")]
    roi: Option<Region>,
    /// How the peak is looked for
    #[arg(long, value_enum, default_value = "climb")]
    strategy: StrategyName,
    /// Stop for every sample, or measure while moving
    #[arg(long, value_enum, default_value = "step")]
    mode: ModeName,
    /// The focus of an unstained cell: the minimum between two lobes
    #[arg(long)]
    phase_object: bool,
    /// Distance between samples, µm [default: the smaller of 0.5 and the stack's step]
    #[arg(long, value_name = "UM")]
    sample_step_um: Option<f64>,
    /// How far past the best sample to go: all local maxima lie within this distance of the focus
    #[arg(long, value_name = "UM", default_value_t = 10.0)]
    trap_um: f64,
    /// First step to find the uphill direction, µm
    #[arg(long, value_name = "UM", default_value_t = 5.0)]
    probe_um: f64,
    /// Speed between samples, or of the sweep [default: the axis' own; of a sweep, five frames to a trap radius]
    #[arg(long, value_name = "UM_PER_S", allow_hyphen_values = true)]
    speed_um_s: Option<f32>,
    /// Take a last frame at the result and compare it with the best seen
    #[arg(long)]
    verify: bool,
    /// Write the samples as CSV
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw the focus curve as SVG
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

/// A span of positions relative to the start, µm.
#[derive(Clone, Copy, Debug)]
struct Range {
    low: f64,
    high: f64,
}

impl FromStr for Range {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        let wrong = || String::from("write LO..HI in µm relative to the start, as in -50..50");
        let (low, high) = s.split_once("..").ok_or_else(wrong)?;
        let number = |t: &str| t.trim().parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(wrong);
        let range = Self { low: number(low)?, high: number(high)? };
        if range.low < range.high { Ok(range) } else { Err("the low end must be below the high end".into()) }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum StrategyName {
    /// Probe the direction, one pass uphill, stop a trap radius past the best, return
    Climb,
    /// Steepest ascent, then a blind search to both sides
    Mixed,
    /// The whole range
    Scan,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ModeName {
    Step,
    Sweep,
}

#[derive(Serialize)]
struct Report {
    outcome: &'static str,
    reason: Option<&'static str>,
    z_um: f64,
    start_um: f64,
    travel_um: f64,
    approach_um: f64,
    frames: u32,
    duration_s: f64,
    measure: String,
    samples: Vec<SampleRow>,
}

#[derive(Serialize)]
struct SampleRow {
    z_um: f64,
    phi: f64,
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// What stopped it before the board could decide, or that the board refused.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        interrupt::watch();
        let recorded = Recorded::open(self.camera.as_ref(), self.roi, self.measure, self.start.map(Micrometres))?;
        let model = self.model(recorded.as_ref(), connection.seed);
        let bench = connection.open(Purpose::Control, model)?;
        let scanned = self.focus(connection, bench, recorded)?;
        if let Some(path) = &self.csv {
            std::fs::write(path, plot::csv(&scanned.samples))
                .with_context(|| format!("{}: cannot be written", path.display()))?;
        }
        if let Some(path) = &self.plot {
            plot::svg(path, &scanned, &self.measure.to_string())?;
        }
        self.tell(out, &scanned)
    }

    /// The simulated rig for this scan: around a recorded stack the axis has the stack's extent.
    fn model(&self, recorded: Option<&Recorded>, seed: u64) -> simulated::Model {
        let mut model = simulated::Model { seed, ..simulated::Model::default() };
        if let Some(CameraAddress::Simulated(timing)) = self.camera {
            model.timing = Some(timing);
        }
        if let Some(recorded) = recorded {
            model.limits.push((self.axis, recorded.extent.low, recorded.extent.high));
            model.positions.push((self.axis, self.start.map_or(recorded.middle(), Micrometres)));
        }
        model
    }

    fn focus(&self, connection: &Connection, mut bench: Bench, recorded: Option<Recorded>) -> anyhow::Result<Scanned> {
        let plan = self.plan(recorded.as_ref());
        let mut source: Box<dyn FocusSource> = match (recorded, &bench.simulated) {
            (Some(recorded), _) => recorded.source,
            (None, Some(_)) if matches!(self.camera, Some(CameraAddress::Live(_))) => {
                bail!("a real camera does not see the simulated rig: name the board with --port or --rig")
            }
            (None, Some(rig)) => {
                let roi = simulated_region(rig, self.roi)?;
                Box::new(CameraSource::new(rig.camera(), roi, self.measure, connection.latency()?))
            }
            (None, None) => Box::new(self.live(connection, &mut bench)?),
        };
        let bar = bar();
        let mut show = |progress: Progress| match progress {
            Progress::Sample(Sample { z, phi }) => {
                bar.set_message(format!("z {:9.2} µm   Φ {:.6e}", z.0, phi.0));
                bar.inc(1);
            }
            Progress::Fault(fault) => bar.set_message(format!("no value: {fault:?}")),
            Progress::Pacing { frames, doubt_us } => bar.set_message(format!(
                "learning the camera's pace: exposures known to {:.2} ms after {frames} frames",
                doubt_us / 1000.0
            )),
        };
        let scanned = focus(&mut bench.stage, source.as_mut(), &plan, &mut show, &interrupt::keep_on);
        bar.finish_and_clear();
        bench.stage.close();
        Ok(scanned?)
    }

    /// A real camera's values. A stop for every frame makes do with a careful guess of how late frames come; a sweep needs
    /// the calibrated latency.
    fn live(&self, connection: &Connection, bench: &mut Bench) -> anyhow::Result<CameraSource<Box<dyn Camera>>> {
        let Some(CameraAddress::Live(address)) = &self.camera else {
            bail!("a real board needs a --camera: docs/cameras.md has examples")
        };
        let latency = matches!(self.mode, ModeName::Step).then_some(CAREFUL_LATENCY);
        let mut camera = address.open(latency)?.with_context(|| format!("{address} is no camera of a real rig"))?;
        let roi = match self.roi {
            Some(Region::Drawn(roi)) => Some(roi),
            Some(Region::All) => None,
            None | Some(Region::Sharpest) => sharpest_of(camera.as_mut(), bench.stage.now())?,
        };
        Ok(CameraSource::new(camera, roi, self.measure, connection.latency()?))
    }

    fn plan(&self, recorded: Option<&Recorded>) -> Plan {
        let middle = recorded.map(Recorded::middle);
        let of_stack = recorded.and_then(|r| r.step).map(|step| Micrometres(step.0.min(0.5)));
        Plan {
            start: self.start.map(Micrometres).or(middle),
            range: self.range.map(|r| Span { low: Micrometres(r.low), high: Micrometres(r.high) }),
            extent: recorded.map(|r| r.extent),
            strategy: match self.strategy {
                StrategyName::Climb => Strategy::Climb,
                StrategyName::Mixed => Strategy::Mixed,
                StrategyName::Scan => Strategy::Scan,
            },
            mode: match self.mode {
                ModeName::Step => Mode::Step,
                ModeName::Sweep => Mode::Sweep,
            },
            subject: if self.phase_object { Subject::PhaseObject } else { Subject::Peak },
            sample_step: self.sample_step_um.map(Micrometres).or(of_stack),
            trap: Micrometres(self.trap_um),
            probe: Micrometres(self.probe_um),
            speed: self.speed_um_s.map(MicrometresPerSecond),
            verify: self.verify,
            ..Plan::new(self.axis)
        }
    }

    fn tell(&self, out: Output, scanned: &Scanned) -> anyhow::Result<()> {
        let report = &scanned.report;
        let reason = match report.outcome {
            Outcome::Focused => None,
            Outcome::Refused(why) => Some(scan_refusal(why)),
        };
        let um = |at: Nanometres| at.micrometres().0;
        let value = Report {
            outcome: if reason.is_none() { "focused" } else { "refused" },
            reason,
            z_um: um(report.end),
            start_um: um(report.start),
            travel_um: um(report.travel),
            approach_um: um(report.approach),
            frames: report.frames,
            duration_s: f64::from(report.duration.0) / 1000.0,
            measure: self.measure.to_string(),
            samples: scanned.samples.iter().map(|s| SampleRow { z_um: s.z.0, phi: s.phi.0 }).collect(),
        };
        let text = match reason {
            None => format!(
                "{} in focus at {:.2} µm: {:.1} µm of travel (and {:.1} µm of approach), {} frames, {:.2} s",
                self.axis, value.z_um, value.travel_um, value.approach_um, value.frames, value.duration_s
            ),
            Some(reason) => format!("{} not focused, {reason}; it is back at {:.2} µm", self.axis, value.z_um),
        };
        out.result(&text, &value)?;
        if reason.is_some() { Err(super::Refused.into()) } else { Ok(()) }
    }
}

fn bar() -> ProgressBar {
    let style = ProgressStyle::with_template("{spinner} {pos:>5} frames   {msg}   {elapsed}");
    ProgressBar::new_spinner().with_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()))
}
