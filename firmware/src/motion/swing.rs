//! Vibration: a cosine, edge by edge.

use super::facade::{Known, Motion, Task};
use super::lane::Lane;
use super::limits::{self, TICKS};
use super::math::{acos_turn, cos_quarter};
use super::path::Path;
use super::phase::{Phase, Shape};
use super::stretch::{State, count};
use crate::ports::Board;
use parfocal_protocol::message::{Field, Refusal};
use parfocal_protocol::units::{Hertz, Nanometres, Steps};

/// Largest amplitude, steps: the table of one quarter of a swing has so many edges.
pub const AMPLITUDE: usize = 512;

/// Times of the edges of a quarter swing, from the turning point to the middle, in ticks · 16.
pub type Quarter = [u32; AMPLITUDE];

/// A vibration under way.
#[derive(Clone, Debug)]
pub(super) struct Swinging {
    pub axis: usize,
    amplitude: u32,
    /// Ticks · 2³² of a quarter swing.
    quarter: u64,
    cycles: u16,
    /// Where it rested, motor steps.
    middle: i32,
    /// Stage, nm, of the turning points.
    ends: [Nanometres; 2],
    stage: Stage,
    /// Tick at which the swings begin.
    begin: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Out,
    Swing,
    Back,
    Over,
}

fn within(value: f64, low: f64, high: f64, field: Field) -> Result<(), Refusal> {
    if value >= low && value <= high {
        Ok(())
    } else {
        Err(Refusal::OutOfRange { field, low: low as f32, high: high as f32 })
    }
}

impl Swinging {
    pub fn new(
        known: &Known,
        axis: usize,
        amplitude: Nanometres,
        frequency: Hertz,
        cycles: u16,
    ) -> Result<Self, Refusal> {
        let s = &known.settings;
        let scale = f64::from(s.steps_per_um.0);
        let um = f64::from(amplitude.0) / 1000.0;
        if !frequency.0.is_finite() {
            return Err(Refusal::NotANumber);
        }
        let widest = (AMPLITUDE as f64 / scale).min(1000.0);
        within(um, 1.0 / scale, widest, Field::Amplitude)?;
        let steps = ((um * scale + 0.5) as u32).clamp(1, AMPLITUDE as u32);
        // Speed A·ω and acceleration A·ω² stay within the axis' limits.
        let tau = core::f64::consts::TAU;
        let omega = (f64::from(s.speed.0) / um).min(super::math::sqrt(f64::from(s.acceleration.0) / um));
        // Both pulses at a turning point, and DIR between them, fit into the time there.
        let turn = f64::from(2 * (limits::pulse(s).high + limits::pulse(s).setup) + 400);
        let sharpest = acos_turn(1.0 - 0.5 / f64::from(steps)) * 2.0 * TICKS / turn;
        within(f64::from(frequency.0), 0.1, (omega / tau).min(sharpest).min(1000.0), Field::Frequency)?;
        within(f64::from(cycles), 1.0, 60_000.0, Field::Cycles)?;
        let quarter = TICKS / f64::from(frequency.0) / 4.0;
        let middle = known.seen;
        let stage = middle.wrapping_sub(known.play.slack);
        let at = |steps: i32| s.steps_per_um.nanometres(Steps(stage.saturating_add(steps)));
        Ok(Self {
            axis,
            amplitude: steps,
            quarter: (quarter * 4_294_967_296.0) as u64,
            cycles,
            middle,
            ends: [at(steps as i32), at(-(steps as i32))],
            stage: Stage::Out,
            begin: 0,
        })
    }

    /// Stage positions between which it goes.
    pub fn turning_points(&self) -> [Nanometres; 2] {
        self.ends
    }

    /// Fills in the times of a quarter's edges: the cosine passes amplitude − ½ − i.
    fn table(&self, table: &mut Quarter) {
        let a = f64::from(self.amplitude);
        let ticks = self.quarter as f64 / 4_294_967_296.0 * 4.0 * 16.0;
        for (i, time) in table.iter_mut().enumerate().take(self.amplitude as usize) {
            *time = (acos_turn((a - 0.5 - i as f64) / a) * ticks + 0.5) as u32;
        }
    }

    /// No further stretch begins.
    pub fn stop(&mut self) {
        if self.stage == Stage::Out {
            self.stage = Stage::Over;
        }
    }

    /// Whether the swings themselves go on.
    pub fn swings(&self) -> bool {
        self.stage == Stage::Back && self.begin > 0
    }

    /// A lane that slows down from a tick on, and the edges before it; `None` when the swings are over by then.
    pub fn stopping(&self, tick: u64, known: &Known) -> Option<(Lane, u32)> {
        let ticks = tick.saturating_sub(self.begin);
        let past = u128::from(ticks) << 32;
        let quarters = (past / u128::from(self.quarter.max(1))) as u32;
        if quarters >= 4 * u32::from(self.cycles) {
            return None;
        }
        let part = (past % u128::from(self.quarter.max(1))) as f64 / self.quarter as f64;
        let (a, quarter) = (f64::from(self.amplitude), self.quarter as f64 / 4_294_967_296.0);
        let (sine, cosine) = (cos_quarter(1.0 - part), cos_quarter(part));
        // Away from a turning point, or towards one.
        let from_turn = quarters.is_multiple_of(2);
        let (distance, v) = if from_turn { (a * (1.0 - cosine), sine) } else { (a * sine, cosine) };
        let counts = count(distance, false);
        let up = quarters / 2 % 2 == 1;
        let start = match quarters % 4 {
            0 => self.amplitude as i32,
            2 => -(self.amplitude as i32),
            _ => 0,
        };
        let moved = if up { counts as i32 } else { -(counts as i32) };
        let base = self.middle.wrapping_add(start).wrapping_add(moved);
        let limits = limits::in_ticks(&known.settings);
        let mut path = Path::default();
        let v = v * a * core::f64::consts::FRAC_PI_2 / quarter;
        path.ramp(State { p: 0.0, v, a: 0.0 }, 0.0, limits)?;
        // The play lies where the way since the turning point has taken it.
        let mut play = known.play;
        let since = if from_turn { counts } else { a + counts } as i32;
        play.slack = if up { 0 } else { play.width };
        play.moved(if up { since } else { -since });
        let lane = Lane { begin: tick, path, scale: 1.0, up, base, offset: distance - counts, limits, play };
        Some((lane, quarters * self.amplitude + counts as u32))
    }
}

impl Motion {
    /// Begins the next stretch of a vibration: out to the turning point, the swings, back. False when it is over.
    pub(super) fn swing_on(&mut self, board: &mut impl Board) -> bool {
        let Task::Swing(swinging) = &mut self.task else { return false };
        let swinging_now = swinging.clone();
        let (axis, amplitude) = (swinging_now.axis, swinging_now.amplitude as i32);
        let to = match swinging_now.stage {
            Stage::Out => {
                swinging.stage = Stage::Swing;
                swinging_now.middle.wrapping_add(amplitude)
            }
            Stage::Swing => {
                swinging.stage = Stage::Back;
                self.begin_swings(board, &swinging_now);
                return true;
            }
            Stage::Back => {
                swinging.stage = Stage::Over;
                swinging_now.middle
            }
            Stage::Over => return false,
        };
        self.track_play(board);
        let known = self.known(axis);
        let distance = f64::from(to.wrapping_sub(known.seen));
        let limits = limits::in_ticks(&known.settings);
        if distance != 0.0
            && let Some(path) = Path::rest_to_rest(distance.abs(), limits)
        {
            self.set_lane(axis, path, if distance > 0.0 { 1.0 } else { -1.0 }, limits);
            self.launch(board);
        }
        true
    }

    fn begin_swings(&mut self, board: &mut impl Board, swinging: &Swinging) {
        self.quiet = None;
        self.track_play(board);
        let known = self.known_mut(swinging.axis);
        known.past = known.lane.take();
        // Down past the middle and up again: the play ends on the upper side.
        known.play.moved(-2 * swinging.amplitude as i32);
        known.seen = known.seen.wrapping_sub(2 * swinging.amplitude as i32);
        let begin = board.pulses(|engine| {
            let begin = engine.laid([true; parfocal_protocol::units::AXES]) + 2_000;
            swinging.table(engine.quarter());
            let ticks = (u128::from(swinging.quarter) * 4 * u128::from(swinging.cycles)) >> 32;
            engine.append(
                swinging.axis,
                &[Phase {
                    begin,
                    ticks: ticks as u64,
                    steps: 4 * swinging.amplitude * u32::from(swinging.cycles),
                    up: false,
                    first: 0,
                    shape: Shape::Swing { amplitude: swinging.amplitude, quarter: swinging.quarter },
                }],
            );
            begin
        });
        if let Task::Swing(swinging) = &mut self.task {
            swinging.begin = begin;
        }
    }
}
