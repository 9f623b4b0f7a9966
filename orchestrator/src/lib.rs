//! Looks after the processes of a run: starts them, sequences the drives, restarts what crashed, ends in order.
//!
//! Links no service: it starts processes, by re-executing the binary it is part of or by a user's command.
//! That is what makes a swap of any of them possible by construction.
//!
//! [`sequencer`] and [`restart`] decide, and are pure; [`process`] and `pipeline` act.

pub mod bench;
pub mod cli;
mod conformance;
mod cores;
mod drive;
mod failure;
mod gains;
mod housekeeping;
mod member;
mod observers;
mod pipeline;
mod preflight;
mod presets;
pub mod process;
mod progress;
mod rearm;
mod recovery;
mod replay;
pub mod restart;
mod result;
pub mod sequencer;
mod setup;
mod sweep;
mod tables;
mod terminal;
mod train;
mod vehicle_file;

pub use bench::bench;
pub use conformance::conformance;
pub use drive::drive;
pub use failure::Failure;
pub use gains::gains;
pub use housekeeping::{LivingRun, clean, doctor, living_run, logs, status, stop};
pub use presets::{print_schema, show_config};
pub use rearm::rearm;
pub use replay::{replay, replay_config};
pub use setup::{Ended, name_files};
pub use sweep::{grid, validate};
pub use terminal::{print_failure, print_line, print_usage_error};
pub use train::train;
