//! The paper's control law, and the process that applies it.
//!
//! `law` and `drive` are pure; [`service`] joins them to the pipeline.

mod drive;
mod law;
pub mod service;

pub use drive::{Decision, DriveController, Ended, Seen};
pub use law::{ControlLaw, RawCommand};
