//! The board's short answers in a person's words.

use parfocal_protocol::autofocus::ScanRefusal;
use parfocal_protocol::message::{Field, HomingFault, Refusal, ResetCause, StopCause};
use parfocal_protocol::settings::Side;
use parfocal_protocol::units::{Axis, Nanometres};
use std::fmt;

/// Displays an answer of the board as a sentence.
pub struct Explained<'a, T>(pub &'a T);

fn um(at: Nanometres) -> f64 {
    at.micrometres().0
}

fn side(side: Side) -> &'static str {
    match side {
        Side::Low => "low",
        Side::High => "high",
    }
}

impl fmt::Display for Explained<'_, Refusal> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self.0 {
            Refusal::NoSession => {
                write!(f, "the board has restarted and does not know this program any more: connect again")
            }
            Refusal::NotInControl { controller } => {
                write!(f, "another program (session {:08x}) controls the board: close it or take control", controller.0)
            }
            Refusal::OldSequence => write!(f, "the board has answered a later request already: connect again"),
            Refusal::NoSuchAxis { axis: Axis(n) } => {
                write!(f, "the board has no axis {n}: `parfocal status` lists its axes")
            }
            Refusal::BeyondLimit { axis: Axis(n), low, high } => write!(
                f,
                "axis {n} may only go from {} to {} µm: choose a position in between, or change the limits with `parfocal settings set`",
                um(low),
                um(high)
            ),
            Refusal::Busy => write!(f, "something is still moving: wait for it or stop it"),
            Refusal::QueueFull => write!(f, "the board's queue of moves is full: wait for one to end"),
            Refusal::Emergency => write!(f, "the emergency stop is in force: release it, then `parfocal stop --clear`"),
            Refusal::AtHardLimit { axis: Axis(n), side: s } => {
                write!(f, "axis {n} presses its {} limit switch: move it the other way", side(s))
            }
            Refusal::OutOfRange { field, low, high } => {
                write!(f, "{} must lie between {low} and {high}", field_name(field))
            }
            Refusal::NoSuchScan { current: Some(id) } => {
                write!(f, "that scan is over or was never begun; the board's scan is number {}", id.0)
            }
            Refusal::NoSuchScan { current: None } => write!(f, "the board has no scan under way"),
            Refusal::WrongSample { wanted } => write!(f, "the scan wants sample {wanted}, not that one"),
            Refusal::NotANumber => write!(f, "the value is not a finite number"),
            Refusal::NoHomeSwitch { axis: Axis(n) } => {
                write!(f, "axis {n} has no home switch in its settings: set `home` to low or high if one is wired")
            }
            Refusal::CannotSave => write!(
                f,
                "the board cannot keep settings over a power cycle now (flash busy, worn, or a chip revision on which it must not)"
            ),
            Refusal::NoTrigger { axis: Axis(n) } => {
                write!(
                    f,
                    "steps of axis {n} cannot give camera pulses: on this board those of its first three axes can"
                )
            }
            Refusal::WrongTime { earliest, latest } => write!(
                f,
                "the frame's time is not between {} and {} µs by the board's clock: frames come in the order of their exposure, after it",
                earliest.0, latest.0
            ),
            Refusal::Unsupported => write!(
                f,
                "the board's firmware cannot do this: flash it with this program's firmware (`cargo xtask flash`)"
            ),
        }
    }
}

/// A field as it is called in settings files and on the command line, with its unit.
pub fn field_name(field: Field) -> &'static str {
    match field {
        Field::StepsPerUm => "steps_per_um",
        Field::Speed => "speed_um_s",
        Field::Acceleration => "acceleration_um_s2",
        Field::Jerk => "jerk_um_s3",
        Field::Low => "low_um",
        Field::High => "high_um",
        Field::Backlash => "backlash_um",
        Field::Settling => "settling_ms",
        Field::HomeSpeed => "home_speed_um_s",
        Field::HomeAt => "home_at_um",
        Field::HostTimeout => "host_timeout_ms",
        Field::Telemetry => "telemetry_hz",
        Field::SampleStep => "the sample step (µm)",
        Field::Trap => "the trap radius (µm)",
        Field::Probe => "the probe (µm)",
        Field::ScanRange => "the range of the scan (µm)",
        Field::SampleTimeout => "the sample timeout (ms)",
        Field::Amplitude => "the amplitude (µm)",
        Field::Frequency => "the frequency (Hz)",
        Field::Cycles => "the number of cycles",
        Field::Trigger => "the trigger plan",
        Field::Microsteps => "microsteps",
    }
}

impl fmt::Display for Explained<'_, StopCause> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self.0 {
            StopCause::Asked => write!(f, "it was told to stop"),
            StopCause::HostLost => write!(f, "the board heard nothing from this program for too long"),
            StopCause::ControlTaken => write!(f, "another program took control"),
            StopCause::HardLimit { axis: Axis(n), side: s } => {
                write!(f, "axis {n} ran into its {} limit switch", side(s))
            }
            StopCause::Emergency => write!(f, "emergency stop; the position is counted but not trusted: home the axes"),
            StopCause::Underrun { axis: Axis(n) } => {
                write!(f, "pulses for axis {n} came too late; its position is not trusted: home it")
            }
            StopCause::Homing { axis: Axis(n), fault } => {
                let why = match fault {
                    HomingFault::Stuck => "the switch reads pressed everywhere: stuck, or its wire is broken",
                    HomingFault::Missing => "the switch was never met: not wired, or the travel is too short",
                    HomingFault::WrongSide => "the other end's switch was met: `home` or `inverted` is set wrong",
                };
                write!(f, "homing of axis {n} failed, {why}")
            }
        }
    }
}

/// A reset's cause in words.
pub fn reset_cause(cause: ResetCause) -> &'static str {
    match cause {
        ResetCause::Power => "power came on",
        ResetCause::Pin => "reset button",
        ResetCause::Software => "restarted on request",
        ResetCause::Watchdog => "the watchdog found its program hanging",
        ResetCause::Panic => "its program stopped in an impossible state",
    }
}

/// The reason of a refused scan: the strings that `parfocal autofocus --json` gives as `reason`.
pub fn scan_refusal(refusal: ScanRefusal) -> &'static str {
    match refusal {
        ScanRefusal::NoContrast => "no contrast",
        ScanRefusal::Saturated => "saturated",
        ScanRefusal::PeakAtEdge => "peak at the edge of the range",
        ScanRefusal::NoSignificantPeak => "no significant peak",
        ScanRefusal::TwoPeaks => "two peaks",
        ScanRefusal::PhaseObject => "phase object",
        ScanRefusal::LightDrifts => "light drifts",
        ScanRefusal::SamplesStopped => "samples stopped",
        ScanRefusal::StaleFrames => "stale frames",
        ScanRefusal::Aborted => "aborted",
        ScanRefusal::MotionStopped => "motion stopped",
        ScanRefusal::NotReproduced => "not reproduced",
    }
}
