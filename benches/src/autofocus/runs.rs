//! One scan on one curve, by the board's own code or by another's search.

use super::curves::Truth;
use super::{STEP, TRAP};
use anyhow::{Result, bail};
use parfocal_firmware::autofocus::curve::Curve;
use parfocal_firmware::autofocus::search::Search;
use parfocal_firmware::autofocus::{Ask, Scan};
use parfocal_protocol::autofocus::{Mode, ScanId, ScanParameters, Strategy, Subject};
use parfocal_protocol::units::{Axis, FocusValue, MicrometresPerSecond, Milliseconds, Nanometres};
use parfocal_simulator::strategies::{self, Brent, CoarseFine, Golden};
use serde::Serialize;

/// How the peak is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum By {
    /// The board's default: one pass uphill that knows its noise
    Climb,
    /// The chapter's method: steepest ascent, then 10 µm to both sides
    Mixed,
    /// The whole range
    Scan,
    /// Golden-section search over the range
    Golden,
    /// The range in 5 µm steps, then every step around the largest
    CoarseFine,
    /// Brent's method over the range, as Micro-Manager's OughtaFocus
    Brent,
}

/// What a scan did.
pub struct Walk {
    /// All positions in order, µm, from the start to the result.
    pub way: Vec<f64>,
    /// Frames taken.
    pub frames: u32,
}

impl Walk {
    /// Σ|dz|, µm.
    pub fn travel(&self) -> f64 {
        self.way.windows(2).map(|w| (w[1] - w[0]).abs()).sum()
    }

    /// Where it ended, µm.
    pub fn end(&self) -> f64 {
        self.way.last().copied().unwrap_or(f64::NAN)
    }
}

/// Runs one scan from `z0` with a probe of `j0`, µm, under relative noise.
///
/// # Errors
/// When the board refuses the parameters, which a curve of the family gives no cause for.
pub fn run(curve: &Truth, by: By, z0: f64, noise: f64, j0: f64) -> Result<Walk> {
    let board = |strategy| board(curve, strategy, z0, noise, j0);
    match by {
        By::Climb => board(Strategy::Climb),
        By::Mixed => board(Strategy::Mixed),
        By::Scan => board(Strategy::Scan),
        By::Golden => Ok(other(curve, &mut Golden::default(), z0, noise)),
        By::CoarseFine => Ok(other(curve, &mut CoarseFine::default(), z0, noise)),
        By::Brent => Ok(other(curve, &mut Brent::default(), z0, noise)),
    }
}

/// The board's own scan, frame by frame.
fn board(curve: &Truth, strategy: Strategy, z0: f64, noise: f64, j0: f64) -> Result<Walk> {
    let parameters = ScanParameters {
        scan: ScanId(1),
        axis: Axis(0),
        strategy,
        mode: Mode::Step,
        subject: Subject::Peak,
        low: nm(-curve.r),
        high: nm(curve.r),
        sample_step: nm(STEP),
        trap: nm(TRAP),
        probe: nm(j0),
        speed: MicrometresPerSecond(0.0),
        sample_timeout: Milliseconds(1_000),
        verify: false,
    };
    let Ok((mut scan, mut ask)) = Scan::begin(&parameters, nm(z0)) else {
        bail!("curve {}: the scan's parameters are refused", curve.id)
    };
    let mut walk = Walk { way: vec![z0], frames: 0 };
    loop {
        ask = match ask {
            Ask::Sample { z } => {
                let um = z.micrometres().0;
                walk.way.push(um);
                let value = curve.frame(walk.frames, um, noise);
                walk.frames += 1;
                scan.sample(z, Ok(FocusValue(value)))
            }
            Ask::Go { z } => {
                walk.way.push(z.micrometres().0);
                scan.arrived(z)
            }
            Ask::Think => scan.think(),
            Ask::Ended(_) => return Ok(walk),
            Ask::Sweep { .. } | Ask::Wait => bail!("curve {}: a stepwise scan wants to sweep", curve.id),
        };
    }
}

/// Another's search; its answer is its largest sample.
fn other(truth: &Truth, search: &mut dyn Search, z0: f64, noise: f64) -> Walk {
    let mut curve = Curve::new(nm(z0), nm(-truth.r), nm(truth.r), nm(STEP));
    let frame = |k, z| truth.frame(k, Nanometres(z).micrometres().0, noise);
    let (way, frames) = strategies::run(search, &mut curve, frame);
    Walk { way: way.iter().map(|z| Nanometres(*z).micrometres().0).collect(), frames }
}

fn nm(um: f64) -> Nanometres {
    Nanometres((um * 1000.0).round() as i32)
}
