//! The configuration of a run: the TOML presets in this folder, their schema, and clear errors for users who
//! edit them.
//!
//! A run's configuration is a stack of layers, each a TOML document with the same keys: `readings.toml`,
//! the manoeuvre, the vehicle (under `vehicle.`), a user's file, single keys. [`Layers`] stacks them and
//! remembers where each value was set; [`Layers::resolve`] parses the result once into a [`RunConfig`],
//! which is valid by construction: nothing needs to check it again.
//!
//! SI units and radians throughout; the suffix of a key is its unit.

mod car_size;
mod envelope;
mod error;
mod files;
mod fits;
mod grid;
pub mod identified;
pub mod launch;
mod law;
mod layers;
mod lengths;
mod made_path;
mod overlay;
mod own_path;
mod path_file;
mod plants;
mod points;
mod presets;
pub mod promote;
mod resample;
mod ros2;
mod schema;
pub mod slots;
mod smooth;
mod speed_profile;
mod start_at;
mod stated;
mod sweep;
mod switches;
mod textbook;
mod tuned;
mod validate;
mod vehicles;

pub use envelope::{ChannelScale, ENVELOPE_CHANNELS, Envelope, MadeFor, Promise};
pub use error::ConfigError;
pub use files::{BoundedLines, open_regular, read_small};
pub use grid::{Axes, Axis, Grid, GridAxis, GridPosition};
pub use law::{
    LawConfig, MAX_PARAMETERS, NamedParameters, ParameterConfig, Parameters, Scale, Settings,
    paper_law, preset as law_preset,
};
pub use layers::Layers;
pub use overlay::{Found, find_key, nearest_keys, overlay};
pub use path_file::{Columns, Crs, PathOptions, RecordedPath};
pub use plants::{Over, OverBy, PerPlant, PlantChange};
pub use presets::{Preset, maneuver_names, names_in, nearest, presets};
pub use ros2::{Align, CollisionMessage, DriveMessage, Ros2, Ros2Reliability};
pub use schema::*;
pub use start_at::StartAt;
pub use stated::{Spread, StatedNoise, Uncertainty};
pub use sweep::{SweepKind, SweepPlan};
pub use switches::ZoneRegion;
pub use textbook::TextbookSet;
pub use tuned::{PastGains, Provenance, Replacement, TunedGains};

/// The largest fleet that one message carries.
pub const MAX_FLEET: usize = validate::MAX_FLEET as usize;
