//! The control laws, and the process that applies one.
//!
//! [`laws`], `drive` and [`clock`] are pure; [`service`] joins them to the pipeline.

// Tests may read and write files, start threads, and know the time.
#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

pub mod clock;
mod compensation;
mod drive;
pub mod laws;
mod quadratic;
#[cfg(feature = "process")]
#[allow(clippy::disallowed_methods, clippy::disallowed_types, reason = "no pure core")]
pub mod service;
mod sight;

pub use drive::{Decision, DriveController, GateWord, Seen};
pub use laws::{ControlLaw, LawState, RawCommand};
pub use sight::Sight;
