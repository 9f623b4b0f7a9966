//! The replayer: drives a recording again, and compares the answers with the recorded ones, bit for bit.
//!
//! [`vehicle`] fills the vehicle's role with the recorded odometry; [`reviewer`] fills the trainer's: it asks for the
//! recorded batches one after another, answers zones with the recorded parameters (or with others, under review), and
//! compares raw commands and commands with those of the recording. Everything else is the ordinary pipeline.

pub mod reviewer;
mod script;
pub mod vehicle;

pub use script::{Order, check};
