//! What each command does, from its options to what it prints. There is one file for each command or family of small
//! ones.

mod certify;
mod compare;
mod drive;
mod envelopes;
mod excite;
mod gains;
mod housekeeping;
mod identify;
mod presets;
mod rearm;
mod replay;
mod sweep;
mod train;

pub use certify::{Certifiable, certifiable};
pub use compare::{CompareProgress, compare_configs, print_comparisons};
pub use identify::{Identified, conclude, roll_back, vehicle_of};
pub use replay::{replay, replay_config};

pub(crate) use drive::{DriveTools, drive};
pub(crate) use excite::excite;
pub(crate) use gains::gains;
pub(crate) use housekeeping::{clean, doctor, logs, status, stop};
pub(crate) use presets::{print_schema, show_config};
pub(crate) use rearm::rearm;
pub(crate) use sweep::{grid, resolve_validation, validate, validate_silently};
pub(crate) use train::{resolve_training, train, train_silently};
