//! What a run needs in addition to its pipeline: checks of the machine, a folder, a result, and a place where other
//! terminals find it.

pub(crate) mod files;
pub(crate) mod folder;
pub(crate) mod preflight;
pub(crate) mod result;
pub(crate) mod running;
pub(crate) mod setup;
pub(crate) mod state;
pub(crate) mod temporary;
pub(crate) mod vehicle_file;

pub use folder::resolved_config;
pub use result::EndedRun;
pub use setup::BagReader;
pub use state::{LivingRun, known_of_car, living_run};
