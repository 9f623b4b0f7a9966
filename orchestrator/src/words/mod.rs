//! What is said to the user: lines, tables, and how a command failed.

mod baselines;
pub(crate) mod comparison;
pub(crate) mod failure;
mod laps;
pub(crate) mod plants;
mod simulated;
pub(crate) mod tables;
pub(crate) mod terminal;
mod training;

pub use failure::Failure;
pub(crate) use failure::known;
pub use tables::print_table;
pub use terminal::{print_failure, print_line, print_usage_error};
