//! `parfocal autofocus`: brings an axis into focus and says how.

use super::connection::{Bench, Connection, Purpose};
use super::{Output, interrupt, simulated};
use anyhow::{Context, bail};
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use parfocal::autofocus::source::{CameraSource, CurveSource, FocusSource, StackSource};
use parfocal::autofocus::{Progress, Sample, Scanned, plot, run};
use parfocal::focus::Measure;
use parfocal::frames::curve::Curve;
use parfocal::frames::stack::Stack;
use parfocal::link::explain::scan_refusal;
use parfocal::picture::Roi;
use parfocal::rig::AxisName;
use parfocal_protocol::autofocus::{Mode, Outcome, ScanId, ScanParameters, Strategy, Subject};
use parfocal_protocol::units::{Micrometres, MicrometresPerSecond, Milliseconds, Nanometres};
use serde::Serialize;
use std::path::PathBuf;
use std::str::FromStr;

/// Bring an axis into focus
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The axis that moves: the lens, or a manipulator's z
    #[arg(long, default_value = "scope.z", value_name = "AXIS")]
    axis: AxisName,
    /// Where frames come from: sim, stack:DIR or curve:FILE.csv[?noise=REL&seed=N]
    #[arg(long, value_name = "SOURCE")]
    camera: Option<CameraAddress>,
    /// Where to begin, µm on the axis [default: where it is; a stack's or curve's middle]
    #[arg(long, value_name = "UM", allow_hyphen_values = true)]
    start: Option<f64>,
    /// How far to look, µm relative to the start, clipped to the soft limits [default: those limits]
    #[arg(long, value_name = "LO..HI", allow_hyphen_values = true)]
    range: Option<Range>,
    /// The focus measure: `parfocal focus compare` helps to choose
    #[arg(long, default_value = "tenengrad")]
    measure: Measure,
    /// The region whose focus matters, px [default: the stack's, else the whole frame]
    #[arg(long, value_name = "X,Y,W,H")]
    roi: Option<Roi>,
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
    /// Speed between samples, or of the sweep [default: the axis' own]
    #[arg(long, value_name = "UM_PER_S")]
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

/// Where frames come from.
#[derive(Clone, Debug)]
enum CameraAddress {
    Simulated,
    Stack(PathBuf),
    Curve(String),
}

impl FromStr for CameraAddress {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        match s.split_once(':') {
            None if s == "sim" => Ok(Self::Simulated),
            Some(("stack", path)) if !path.is_empty() => Ok(Self::Stack(path.into())),
            Some(("curve", address)) if !address.is_empty() => Ok(Self::Curve(address.into())),
            _ => Err("write sim, stack:DIR or curve:FILE.csv".into()),
        }
    }
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

/// A recorded source and the heights it covers.
struct Recorded {
    source: Box<dyn FocusSource>,
    low: Micrometres,
    high: Micrometres,
    step_um: Option<f64>,
}

impl Arguments {
    /// Runs the command.
    ///
    /// # Errors
    /// What stopped it before the board could decide, or that the board refused.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        interrupt::watch();
        let recorded = self.recorded()?;
        let model = self.model(recorded.as_ref(), connection.seed);
        let bench = connection.open(Purpose::Control, model)?;
        let (scanned, parameters) = self.focus(bench, recorded)?;
        if let Some(path) = &self.csv {
            std::fs::write(path, plot::csv(&scanned.samples))
                .with_context(|| format!("{}: cannot be written", path.display()))?;
        }
        if let Some(path) = &self.plot {
            plot::svg(path, &scanned, &self.measure.to_string())?;
        }
        self.tell(out, &scanned, &parameters)
    }

    fn recorded(&self) -> anyhow::Result<Option<Recorded>> {
        Ok(match &self.camera {
            None | Some(CameraAddress::Simulated) => None,
            Some(CameraAddress::Stack(path)) => {
                let stack = Stack::open(path)?;
                if let Some(note) = stack.note {
                    eprintln!("{}: {note}", path.display());
                }
                let (low, high) = stack.extent();
                let (roi, step_um) = (self.roi.or(stack.roi()), Some(stack.about.z_step_um));
                let source = StackSource::new(stack, roi, self.measure).with_context(|| path.display().to_string())?;
                Some(Recorded { source: Box::new(source), low, high, step_um })
            }
            Some(CameraAddress::Curve(address)) => {
                let curve = Curve::open(address)?;
                let (low, high) = curve.extent();
                Some(Recorded { source: Box::new(CurveSource(curve)), low, high, step_um: None })
            }
        })
    }

    /// The simulated rig for this scan: around a recorded stack the axis has the stack's extent.
    fn model(&self, recorded: Option<&Recorded>, seed: u64) -> simulated::Model {
        let mut model = simulated::Model { seed, ..simulated::Model::default() };
        if let Some(recorded) = recorded {
            model.limits.push((self.axis, recorded.low, recorded.high));
            let middle = Micrometres((recorded.low.0 + recorded.high.0) / 2.0);
            model.positions.push((self.axis, self.start.map_or(middle, Micrometres)));
        }
        model
    }

    fn focus(&self, mut bench: Bench, recorded: Option<Recorded>) -> anyhow::Result<(Scanned, ScanParameters)> {
        let settings = bench.stage.settings(self.axis)?;
        let (mut low, mut high) = (settings.low.micrometres().0, settings.high.micrometres().0);
        let mut middle = None;
        if let Some(recorded) = &recorded {
            (low, high) = (low.max(recorded.low.0), high.min(recorded.high.0));
            middle = Some((recorded.low.0 + recorded.high.0) / 2.0);
        }
        if low >= high {
            bail!("the source covers no part of {}'s travel of {low} to {high} µm", self.axis);
        }
        if let Some(start) = self.start.or(middle) {
            // Half a nanometre: what the link rounds away.
            if start < low - 5e-4 || start > high + 5e-4 {
                bail!("--start {start} lies outside {low} to {high} µm, where {} can go and pictures exist", self.axis);
            }
            let there = bench.stage.position(self.axis)?;
            if (there.0 - start).abs() > 5e-4 {
                bench.stage.move_to(&[(self.axis, Micrometres(start))], None, &interrupt::keep_on)?;
            }
        }
        let start = bench.stage.position(self.axis)?.0;
        if let Some(range) = self.range {
            (low, high) = (low.max(start + range.low), high.min(start + range.high));
        }
        let step =
            self.sample_step_um.unwrap_or_else(|| recorded.as_ref().and_then(|r| r.step_um).unwrap_or(0.5).min(0.5));
        let mut source: Box<dyn FocusSource> = match (recorded, &bench.simulated) {
            (Some(recorded), _) => recorded.source,
            (None, Some(simulated)) => {
                let roi = self.roi.or_else(|| simulated.tip_region());
                Box::new(CameraSource { camera: simulated.camera(), roi, measure: self.measure })
            }
            (None, None) => bail!("a real board needs a --camera: stack:DIR or curve:FILE.csv"),
        };
        let parameters = self.parameters(low, high, step)?;
        let (link, axis) = bench.stage.find(self.axis)?;
        let parameters = ScanParameters { axis, ..parameters };
        let bar = bar();
        let mut show = |progress: Progress| match progress {
            Progress::Sample(Sample { z, phi }) => {
                bar.set_message(format!("z {:9.2} µm   Φ {:.6e}", z.0, phi.0));
                bar.inc(1);
            }
            Progress::Fault(fault) => bar.set_message(format!("no value: {fault:?}")),
        };
        let scanned = run(link, &parameters, source.as_mut(), &mut show, &interrupt::keep_on)?;
        bar.finish_and_clear();
        bench.stage.close();
        Ok((scanned, parameters))
    }

    fn parameters(&self, low: f64, high: f64, step: f64) -> anyhow::Result<ScanParameters> {
        let nm = |name: &str, um: f64| -> anyhow::Result<Nanometres> {
            Micrometres(um).nanometres().with_context(|| format!("{name} {um} µm is no length a stage can have"))
        };
        Ok(ScanParameters {
            scan: ScanId((super::connection::fresh_session() & 0xffff) as u16),
            axis: parfocal_protocol::units::Axis(0),
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
            low: nm("the range's low end", low)?,
            high: nm("the range's high end", high)?,
            sample_step: nm("--sample-step-um", step)?,
            trap: nm("--trap-um", self.trap_um)?,
            probe: nm("--probe-um", self.probe_um)?,
            speed: MicrometresPerSecond(self.speed_um_s.unwrap_or(0.0)),
            sample_timeout: Milliseconds(2000),
            verify: self.verify,
        })
    }

    fn tell(&self, out: Output, scanned: &Scanned, _parameters: &ScanParameters) -> anyhow::Result<()> {
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
