//! The figures that the scenarios measure, as `cargo xtask emulate --json` prints them.

use serde::Serialize;

/// Measured figures; one that no scenario of this run measured is absent.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Figures {
    /// Greatest distance of a STEP or DIR edge from its planned tick, ticks of 11.9 ns.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub edge_jitter_ticks: Option<u64>,
    /// Flash that the program takes, bytes.
    pub flash_bytes: u64,
    /// RAM that its variables take, bytes.
    pub ram_bytes: u64,
}
