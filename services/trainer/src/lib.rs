//! The trainer: tuners that propose parameters, the journal that records every step, and the process around them.
//!
//! [`tuners`], [`Training`] and [`Ranking`] are pure; [`journal`] reads and writes one file; [`service`]
//! joins them to the pipeline. The result of a training is determined by the configuration and the
//! reports of its drives, never by their order.

// Tests may read and write files, start threads, and know the time.
#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
mod along;
mod baselines;
pub mod calibration;
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
mod checkpoint;
pub mod compare;
mod digest;
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
mod grid;
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
pub mod journal;
mod over;
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
mod own_drives;
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
mod own_file;
mod packing;
mod plants;
mod q_learner;
mod q_learning;
mod ranking;
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
mod recording;
mod result;
mod rng;
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
mod robust;
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
pub mod schedule;
mod search;
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
pub mod service;
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
mod simulate_first;
mod single;
mod statistics;
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
mod story;
mod sweep;
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
mod sweeping;
mod training;
pub mod tuners;
mod validation;
mod wire;

pub use digest::digest;
pub use grid::{GRID_FILE, GridSweep};
pub use own_drives::OwnDrives;
pub use plants::margin;
pub use ranking::{Ranking, grid_is_driven, objective_of};
pub use recording::Row;
pub use result::{Choice, train_result};
pub use robust::{Finalists, rank_mean};
pub use single::SingleDrive;
pub use statistics::Estimate;
pub use story::{DRIVES_FILE, EPISODES_FILE};
pub use sweep::{PlannedDrive, Sweep};
pub use training::{Taken, Training, VisitedSet, by_values, train_by_rollout, train_offline};
pub use tuners::Tuner;
pub use validation::Validation;
pub use wire::Driven;
