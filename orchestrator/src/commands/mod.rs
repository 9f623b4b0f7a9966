//! What each command does, from its options to what it prints. One file a command, or a family of small ones.

mod drive;
mod gains;
pub(crate) mod housekeeping;
mod presets;
mod rearm;
mod replay;
pub(crate) mod sweep;
pub(crate) mod train;

pub use drive::drive;
pub use gains::gains;
pub use housekeeping::{LivingRun, living_run};
pub use housekeeping::{clean, doctor, logs, status, stop};
pub use presets::{print_schema, show_config};
pub use rearm::rearm;
pub use replay::{replay, replay_config};
pub use sweep::{grid, validate};
pub use train::train;
