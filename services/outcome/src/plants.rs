//! A set on plausible plants: vehicles that the car may really be.

use config::NamedParameters;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ParameterTable;

/// What a set does on the plants of the configuration, driven by our simulator without noise. What drives it believes in
/// the vehicle's file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PlantCheck {
    /// Mean distance from the path with the vehicle as its file has it.
    pub path_mean_m: f64,
    /// Largest distance from the path with the vehicle as its file has it. Null in results of earlier versions.
    #[serde(default)]
    pub path_max_m: Option<f64>,
    /// The largest value of the objective on a plant.
    pub worst_value: f64,
    /// Why the set is fragile: a plant more than doubles its mean distance from the path, beyond 0.1 m for a car of full
    /// size, or makes it not arrive, or its additional dead time is too small. Null if it is not.
    pub fragile: Option<String>,
    /// How much later the steering may act. Null in results of earlier versions.
    #[serde(default)]
    pub margin: Option<Margin>,
    /// Each plant, in the order of the configuration.
    pub plants: Vec<PlantDrive>,
    /// With how many of the nominally best sets it is compared.
    pub compared: usize,
    /// The one of these whose worst value on a plant is the least; null if that is the set itself.
    pub alternative: Option<Alternative>,
    /// The same set on plants that were drawn anew, and chose nothing.
    pub fresh: FreshPlants,
}

impl PlantCheck {
    /// The plant with the largest value of the objective.
    pub fn worst(&self) -> Option<&PlantDrive> {
        self.plants.iter().max_by(|a, b| a.value.total_cmp(&b.value))
    }
}

/// How much later than the vehicle's file says the steering may act until the loop oscillates: the additional dead time Δ,
/// at the highest speed that the drive without noise holds for a second.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Margin {
    /// That speed.
    pub speed_mps: f64,
    /// Δ: 0 if the loop is unstable; null if it has no bound, or nothing is known of it.
    pub additional_dead_time_s: Option<f64>,
    /// Below this a set is fragile.
    pub fragile_below_s: f64,
    /// Why nothing is known of it; null if something is.
    pub unknown: Option<String>,
    /// From where on a straight path, at that speed, the loop is certain to converge; null if there is no certificate, and in
    /// results of earlier versions.
    #[serde(default)]
    pub certified: Option<Extent>,
    /// Why there is none.
    #[serde(default)]
    pub no_certificate: Option<String>,
    /// From where it converges when it is simulated (300 of 300 starts); null if the loop is unstable, and in results of
    /// earlier versions.
    #[serde(default)]
    pub simulated: Option<Extent>,
}

/// An extent of states beside a path: offset and heading, both ways.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Extent {
    /// Offset from the path.
    pub offset_m: f64,
    /// Heading against the path.
    pub heading_rad: f64,
}

impl Margin {
    /// Why a set with this margin is fragile, if it is.
    pub fn why_fragile(&self) -> Option<String> {
        let Self { speed_mps, additional_dead_time_s, fragile_below_s, .. } = *self;
        let margin_s = additional_dead_time_s.filter(|it| *it < fragile_below_s)?;
        Some(match margin_s {
            0.0 => format!(
                "at {speed_mps:.2} m/s its loop is unstable with the vehicle's dead time and lag"
            ),
            _ => format!(
                "at {speed_mps:.2} m/s the steering may act only {:.0} ms later until the loop oscillates, less than {:.0} ms",
                1000.0 * margin_s,
                1000.0 * fragile_below_s
            ),
        })
    }
}

/// A drive on a plant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PlantDrive {
    /// How it differs from the vehicle's file.
    pub name: String,
    /// Value of the objective.
    pub value: f64,
    /// By which share that exceeds the least of the sets compared on the same plant; null if that is 0.
    pub regret: Option<f64>,
    /// Mean distance from the path.
    pub path_mean_m: f64,
    /// Largest distance from the path.
    pub path_max_m: f64,
    /// Whether the drive ended at the end of the path.
    pub arrived: bool,
}

/// A set that is steadier over the plants.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Alternative {
    /// The set.
    #[schemars(with = "ParameterTable")]
    pub gains: NamedParameters,
    /// Value of the objective with the vehicle as its file has it.
    pub value: f64,
    /// The largest value on a plant.
    pub worst_value: f64,
}

/// A set on plants that were drawn anew: each key lies between the least and the largest change of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FreshPlants {
    /// How many.
    pub plants: usize,
    /// Whether these drives have noise on the measured pose, another one on each plant; false in results of earlier
    /// versions.
    #[serde(default)]
    pub noise: bool,
    /// The mean distance from the path that 95 % of them do not exceed.
    pub path_mean_p95_m: f64,
    /// The largest mean distance from the path.
    pub path_mean_max_m: f64,
    /// The largest distance from the path in any drive.
    pub path_max_m: f64,
    /// On how many it was more than 1 m from the path.
    pub beyond_1_m: usize,
    /// On how many the drive did not end at the end of the path.
    pub not_arrived: usize,
}
