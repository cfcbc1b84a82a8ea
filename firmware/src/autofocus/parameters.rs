//! Which parameters make sense.

use super::curve::{CELLS, STRIDE};
use parfocal_protocol::autofocus::{Mode, ScanParameters};
use parfocal_protocol::message::{Field, Refusal};
use parfocal_protocol::units::Nanometres;

/// Most sample steps in a range: places are counted in 16 bits.
const STEPS: i64 = i16::MAX as i64 / STRIDE as i64 - 1;

/// Most sample steps in the range of a sweep.
const SWEPT: i64 = CELLS as i64 / STRIDE as i64 - 2;

/// Most sample steps in a trap radius: the curve keeps both sides of the best, and some.
const TRAP: i64 = CELLS as i64 / STRIDE as i64 / 2 - 16;

/// Refuses parameters that make no sense, naming the first one.
pub fn check(p: &ScanParameters, z0: Nanometres) -> Result<(), Refusal> {
    let um = |nm: i64| nm as f32 / 1000.0;
    let within = |field, value: i64, low: i64, high: i64| {
        let refusal = Refusal::OutOfRange { field, low: um(low), high: um(high) };
        if value >= low && value <= high { Ok(()) } else { Err(refusal) }
    };
    let (low, high, step) = (i64::from(p.low.0), i64::from(p.high.0), i64::from(p.sample_step.0));
    let range = high - low;
    within(Field::ScanRange, range, i64::from(STRIDE), i64::from(i32::MAX / 4))?;
    within(Field::ScanRange, i64::from(z0.0), low, high)?;
    // A sweep does not go back for what it forgot: it keeps its whole range.
    let steps = if p.mode == Mode::Sweep { SWEPT } else { STEPS };
    within(Field::SampleStep, step, (range / steps + 1).max(i64::from(STRIDE)), range)?;
    // A range shorter than the trap radius is simply scanned.
    within(
        Field::Trap,
        i64::from(p.trap.0),
        step,
        (TRAP * step).max(if range <= TRAP * step { i64::from(i32::MAX) } else { 0 }),
    )?;
    within(Field::Probe, i64::from(p.probe.0), step, i64::from(i32::MAX))?;
    let finite = p.speed.0.is_finite() && p.speed.0 >= 0.0;
    if !finite {
        return Err(Refusal::OutOfRange { field: Field::Speed, low: 0.0, high: f32::MAX });
    }
    if p.sample_timeout.0 == 0 {
        return Err(Refusal::OutOfRange { field: Field::SampleTimeout, low: 1.0, high: u32::MAX as f32 });
    }
    Ok(())
}
