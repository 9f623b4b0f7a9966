//! The simulated vehicle: a single track with a car's actuators, and the process that publishes it.
//!
//! `vehicle` and `lateral` are pure; [`service`] joins it to the pipeline.

// Tests may read and write files, start threads, and know the time.
#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

mod lateral;
mod noise;
mod road;
#[cfg(feature = "process")]
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
pub mod service;
mod vehicle;

pub use vehicle::{Observation, SimulatedVehicle};
