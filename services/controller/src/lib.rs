//! The control laws, and the process that applies one.
//!
//! [`laws`], `drive` and [`clock`] are pure; [`service`] joins them to the pipeline.

pub mod clock;
mod drive;
pub mod laws;
#[cfg(feature = "process")]
pub mod service;
mod sight;

pub use drive::{Decision, DriveController, Seen};
pub use laws::{ControlLaw, LawState, RawCommand};
pub use sight::Sight;
