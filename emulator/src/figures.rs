//! The figures that the scenarios measure, as `cargo xtask emulate --json` prints them.

use crate::scenarios::Times;
use serde::Serialize;

/// Measured figures; one that no scenario of this run measured is absent.
#[derive(Clone, Debug, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub struct Figures {
    /// Greatest distance of a STEP or DIR edge from its planned tick, ticks of 11.9 ns.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub edge_jitter_ticks: Option<u64>,
    /// Greatest distance of a STEP edge from the exact profile, ticks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile_error_ticks: Option<f64>,
    /// Steps a second on one axis, both edges of STEP being steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub edges_per_s_1_axis: Option<u64>,
    /// The same on three axes together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub edges_per_s_3_axes: Option<u64>,
    /// Steps a second on one axis, rising edges being steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub single_edge_steps_per_s_1_axis: Option<u64>,
    /// The same on three axes together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub single_edge_steps_per_s_3_axes: Option<u64>,
    /// Instructions of the step interrupt a step at constant speed, rising edges: a record a step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instructions_per_step_cruise: Option<f64>,
    /// The same while speeding up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instructions_per_step_ramp: Option<f64>,
    /// Instructions of the step interrupt a step at constant speed, both edges.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instructions_per_edge_cruise: Option<f64>,
    /// The same while speeding up. A record has two edges.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instructions_per_edge_ramp: Option<f64>,
    /// Greatest part of its period that the step interrupt takes in a whole move, one axis at its top rate, both edges.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub service_load_1_axis: Option<f64>,
    /// The same, three axes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub service_load_3_axes: Option<f64>,
    /// Greatest distance of a camera pulse from its step, ticks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trigger_jitter_ticks: Option<u64>,
    /// How long a decision after a scan's sample holds the board up, µs: instructions × 1.5 at 168 MHz, interrupts included; the
    /// slowest one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_decision_us: Option<f64>,
    /// The same until the next move is planned and the answer queued.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_to_move_us: Option<f64>,
    /// From a sample to a decision that was left and taken up again, ms: the slowest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_decided_ms: Option<f64>,
    /// From a sample sent over USB to the answer, by when the next move is decided: the slowest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_round_trip_ms: Option<f64>,
    /// From a stop request to the first slower step, transport included.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stop_latency_ms: Option<f64>,
    /// Flash that the program takes, bytes.
    pub flash_bytes: u64,
    /// RAM that its variables take, bytes.
    pub ram_bytes: u64,
}

impl Figures {
    /// Notes what decisions of a scan took, if they took longer than those known.
    pub fn decided(&mut self, times: &Times) {
        let note = |figure: &mut Option<f64>, took: f64, digits: f64| {
            let took = (took * digits).round() / digits;
            *figure = Some(figure.map_or(took, |known: f64| known.max(took)));
        };
        note(&mut self.sample_decision_us, times.decision_us, 10.0);
        note(&mut self.sample_decided_ms, times.decided_ms, 1000.0);
        note(&mut self.sample_to_move_us, times.planned_us, 10.0);
        note(&mut self.sample_round_trip_ms, times.answer_ms, 1000.0);
    }
}
