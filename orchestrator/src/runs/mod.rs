//! What a run needs around its pipeline: checks of the machine, a folder, a result, and a place where other terminals
//! find it.

pub(crate) mod preflight;
pub(crate) mod result;
pub(crate) mod setup;
pub(crate) mod vehicle_file;

pub use setup::{Ended, name_files};
