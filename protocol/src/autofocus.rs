//! What is said about a scan for focus. The board decides every move; the host turns frames into values.

use crate::units::{Axis, BoardTime, FocusValue, MicrometresPerSecond, Milliseconds, Nanometres};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A scan, by a number that the host gives it. Samples for another one are refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, Schema, MaxSize)]
pub struct ScanId(pub u16);

/// How a scan looks for the peak.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Strategy {
    /// Probe the direction against the noise, one pass uphill, stop a trap radius past the best, return.
    #[default]
    Climb,
    /// Steepest ascent to a maximum, then a blind search of one trap radius to both sides.
    Mixed,
    /// The whole range.
    Scan,
}

/// When samples are taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Mode {
    /// Move, settle, ask for a sample, wait for it.
    #[default]
    Step,
    /// Move at constant speed; the host streams (time, value).
    Sweep,
}

/// What kind of curve is expected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Subject {
    /// The focus is the highest peak.
    #[default]
    Peak,
    /// An unstained cell: the focus is the minimum between two lobes.
    PhaseObject,
}

/// Everything a scan needs to know. Positions are the axis', not relative to the start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub struct ScanParameters {
    /// The host's number for this scan.
    pub scan: ScanId,
    /// The axis that moves: the lens, or a manipulator's z.
    pub axis: Axis,
    /// How the peak is looked for.
    pub strategy: Strategy,
    /// Stepwise or sweeping.
    pub mode: Mode,
    /// The kind of curve.
    pub subject: Subject,
    /// Lowest position to visit.
    pub low: Nanometres,
    /// Highest position to visit.
    pub high: Nanometres,
    /// Distance between neighbouring samples.
    pub sample_step: Nanometres,
    /// All local maxima lie within this distance of the peak: how far past the best sample the scan goes.
    pub trap: Nanometres,
    /// Length of the first probe for the uphill direction, J0.
    pub probe: Nanometres,
    /// Speed of a sweep and of the moves between samples; 0 means the axis' own.
    pub speed: MicrometresPerSecond,
    /// How long to wait for one sample before the scan ends with 'samples stopped'.
    pub sample_timeout: Milliseconds,
    /// Whether to ask for a last sample at the result and compare it with the best seen.
    pub verify: bool,
}

/// What the board wants next, told again until it is answered.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub struct SampleWanted {
    /// The scan.
    pub scan: ScanId,
    /// Number of the sample, from 0.
    pub index: u32,
    /// Where the axis is.
    pub z: Nanometres,
    /// Since when it has been there, settled: a frame exposed earlier is stale.
    pub since: BoardTime,
}

/// One value of the focus measure, answering a [`SampleWanted`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub struct FocusSample {
    /// The scan.
    pub scan: ScanId,
    /// Number of the sample that was wanted.
    pub index: u32,
    /// The value, or why there is none.
    pub value: Result<FocusValue, FrameFault>,
}

/// One value of the focus measure during a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub struct SweepSample {
    /// The scan.
    pub scan: ScanId,
    /// Number of the frame in this sweep, from 0, growing.
    pub index: u32,
    /// Middle of the exposure by the board's clock.
    pub at: BoardTime,
    /// The value, or why there is none.
    pub value: Result<FocusValue, FrameFault>,
}

/// Why a frame gave no usable value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum FrameFault {
    /// No structure: every pixel alike.
    Blank,
    /// Too many pixels at the end of the scale.
    Saturated,
    /// The camera gave only frames from before the move.
    Stale,
    /// The camera gave no frame.
    NoFrame,
}

/// How a scan ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Outcome {
    /// In focus at `best`.
    Focused,
    /// Refused; the axis is back at the start (or on its way there).
    Refused(ScanRefusal),
}

/// Why a scan says no rather than guess.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum ScanRefusal {
    /// The pictures are blank or the curve is flat.
    NoContrast,
    /// The pictures are saturated.
    Saturated,
    /// The best value lies at or beyond an end of the range.
    PeakAtEdge,
    /// Nothing stands out of the noise.
    NoSignificantPeak,
    /// Two peaks further apart than the trap radius, alike in height.
    TwoPeaks,
    /// Two lobes with a deep minimum between: a phase object, which has a mode of its own.
    PhaseObject,
    /// The light changed during the scan.
    LightDrifts,
    /// Samples stopped coming.
    SamplesStopped,
    /// The camera gave only old frames.
    StaleFrames,
    /// Asked to end.
    Aborted,
    /// The axis stopped for another reason: a limit, an emergency stop, a lost host.
    MotionStopped,
    /// The last picture was blurrier than the best seen.
    NotReproduced,
}

/// What came of a scan.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub struct ScanReport {
    /// The scan.
    pub scan: ScanId,
    /// How it ended.
    pub outcome: Outcome,
    /// Where it began.
    pub start: Nanometres,
    /// The peak by the fit; for a refusal the best sample seen.
    pub best: Nanometres,
    /// Where the axis rests.
    pub end: Nanometres,
    /// J: the way travelled from the start to the result.
    pub travel: Nanometres,
    /// Extra way for the approach from the preferred side and for backlash, not in `travel`.
    pub approach: Nanometres,
    /// Samples used.
    pub frames: u32,
    /// From the start to the end.
    pub duration: Milliseconds,
}

/// Where a scan stands.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema, MaxSize)]
pub enum ScanState {
    /// No scan since the board started.
    None,
    /// Moving; the next sample will be asked for.
    Moving(ScanId),
    /// Waiting for a sample.
    Waiting(SampleWanted),
    /// Sweeping: samples are welcome at any time.
    Sweeping(ScanId),
    /// Ended.
    Ended(ScanReport),
}
