//! Live procedures on the simulated rig: real boards and stages in virtual time, eyes that know the truth but for noise.

mod goto;
mod refusals;
#[allow(dead_code, reason = "the tests of unattended runs use the rest")]
mod world;
