//! The paper's high-level supervisor: the safety gate in the command path, and the zones.
//!
//! `gate` is pure; [`service`] joins it to the pipeline.

mod gate;
pub mod service;

pub use gate::{Change, Gate, Passed, SpeedGovernor};
