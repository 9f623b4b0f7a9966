//! The laps of a drive.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One lap of a drive on a path with `path.laps` of 2 or more.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Lap {
    /// Lap time: from the tick at which the vehicle began the lap to the one at which it began the next or reached the
    /// path's end; null for a lap that was not driven to its end.
    pub time_s: Option<f64>,
    /// Mean distance from the path in this lap.
    pub path_mean_m: f64,
    /// Largest distance from the path in this lap.
    pub path_max_m: f64,
}
