//! The trainer: learners that propose gains, the journal that remembers every step, and the process around.
//!
//! [`Learner`], [`Training`] and [`Ranking`] are pure; [`journal`] reads and writes one file; [`service`]
//! joins them to the pipeline. Everything that a training becomes is decided by the configuration and the
//! reports of its drives, never by their order.

mod digest;
pub mod journal;
mod learner;
mod outcome;
mod ranking;
mod rng;
pub mod service;
mod training;

pub use digest::digest;
pub use learner::{DriveRecord, EpisodeRecord, Learner};
pub use outcome::{EpisodeOutcome, GridOutcome, LearnerOutcome, Outcome, PlainOutcome, SetOutcome};
pub use ranking::Ranking;
pub use training::{Step, Training, Wanted, train_by_rollout, train_offline, vote};
