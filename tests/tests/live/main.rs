//! Live procedures on the simulated rig: real boards and stages in virtual time, eyes that know the truth but for noise.

mod goto;
mod refusals;
mod world;
