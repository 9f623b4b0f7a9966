//! The laps of a drive.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One lap of a drive on a path with `path.laps` of 2 or more.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Lap {
    /// Lap time: from the tick at which the vehicle began the lap to the one at which it began the next or reached the
    /// path's end; null for a lap that was not driven to its end.
    pub time_s: Option<f64>,
    /// Mean distance from the path in this lap. The stretch on which a vehicle that starts from rest comes up to the path's
    /// speed is left out of every lap, so that they can be compared.
    pub path_mean_m: f64,
    /// Largest distance from the path in this lap.
    pub path_max_m: f64,
    /// Whether the vehicle stood at a moment of this lap, as in a start from rest: such a lap is slower than the others.
    #[serde(default)]
    pub stood: bool,
}

/// How much alike the laps are in which the vehicle never stood.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alike {
    /// How many laps these are.
    pub count: usize,
    /// The mean of their mean distances from the path.
    pub path_mean_m: f64,
    /// By how much the one that differs most from it does, as a share of it.
    pub apart: f64,
}

/// How much alike whole laps without a standstill are; `None` if there are fewer than two, or no distance at all.
pub fn alike(laps: &[Lap]) -> Option<Alike> {
    let means_m: Vec<f64> = laps
        .iter()
        .filter(|lap| !lap.stood && lap.time_s.is_some())
        .map(|lap| lap.path_mean_m)
        .collect();
    let count = means_m.len();
    let path_mean_m = means_m.iter().sum::<f64>() / count as f64;
    let apart = means_m.iter().map(|it| (it / path_mean_m - 1.0).abs()).fold(0.0, f64::max);
    (count >= 2 && path_mean_m > 0.0).then_some(Alike { count, path_mean_m, apart })
}
