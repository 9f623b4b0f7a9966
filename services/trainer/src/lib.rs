//! The trainer: tuners that propose parameters, the journal that remembers every step, and the process around.
//!
//! [`tuners`], [`Training`] and [`Ranking`] are pure; [`journal`] reads and writes one file; [`service`]
//! joins them to the pipeline. Everything that a training becomes is decided by the configuration and the
//! reports of its drives, never by their order.

mod digest;
mod grid;
pub mod journal;
mod q_learner;
mod q_learning;
mod ranking;
mod recording;
mod result;
mod rng;
mod robust;
pub mod schedule;
pub mod service;
mod single;
mod statistics;
mod story;
mod sweep;
mod sweeping;
mod training;
pub mod tuners;
mod validation;
mod wire;

pub use digest::digest;
pub use grid::{GRID_FILE, GridSweep};
pub use ranking::{Ranking, grid_is_driven, objective_of};
pub use recording::Row;
pub use result::train_result;
pub use robust::{Finalists, rank_mean};
pub use single::SingleDrive;
pub use statistics::Estimate;
pub use story::{DRIVES_FILE, EPISODES_FILE};
pub use sweep::{PlannedDrive, Sweep};
pub use training::{Taken, Training, VisitedSet, by_values, train_by_rollout, train_offline};
pub use tuners::Tuner;
pub use validation::Validation;
pub use wire::Driven;
