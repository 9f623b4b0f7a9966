//! The trainer: learners that propose gains, the journal that remembers every step, and the process around.
//!
//! [`Learner`], [`Training`] and [`Ranking`] are pure; [`journal`] reads and writes one file; [`service`]
//! joins them to the pipeline. Everything that a training becomes is decided by the configuration and the
//! reports of its drives, never by their order.

mod digest;
mod grid;
pub mod journal;
mod learner;
mod outcome;
mod ranking;
mod recording;
mod rng;
mod robust;
pub mod schedule;
pub mod service;
mod single;
mod statistics;
mod sweep;
mod sweeping;
mod training;
mod validation;

pub use digest::digest;
pub use grid::{Flatness, GridSweep, GridSweepOutcome, MainEffect, NamedSet, RankedSet, ValueMean};
pub use learner::{DriveRecord, EpisodeRecord, Learner};
pub use outcome::{
    EpisodeOutcome, GridOutcome, LearnerOutcome, Outcome, PlainOutcome, SetOutcome, Usage,
};
pub use ranking::Ranking;
pub use recording::Row;
pub use robust::{Comparison, FinalistOutcome, Finalists, NoiseOutcome, rank_mean_distance};
pub use single::{SingleDrive, SingleOutcome};
pub use statistics::{Estimate, Verdict};
pub use sweep::{PlannedDrive, Sweep};
pub(crate) use training::vote_by;
pub use training::{Step, Training, Wanted, train_by_rollout, train_offline, vote};
pub use validation::{NoiseFree, Noisy, RowOutcome, Switch, Validation, ValidationOutcome};
