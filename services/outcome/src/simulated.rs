//! What a training that simulated first says of its choice.

use config::NamedParameters;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ParameterTable;

/// What many simulated plants and few drives of the vehicle say together. All of it holds for plants like these: how far
/// the car is one of them, only its own drives can say.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SimulatedFirst {
    /// Plants on which sets were simulated.
    pub plants: usize,
    /// Sets that were simulated on the first plants.
    pub candidates: usize,
    /// Sets that were simulated on all of them: those that were best on the first ones, and the textbook's.
    #[serde(default)]
    pub on_all: usize,
    /// Only sets were driven that stay this near to the path on all these plants.
    pub within_m: f64,
    /// How many sets do.
    pub within: usize,
    /// Drives of the vehicle.
    pub drives: u64,
    /// Drives of the vehicle that were farther from the path.
    pub beyond: u64,
    /// Drives of the vehicle that did not arrive.
    #[serde(default)]
    pub not_arrived: u64,
    /// Whether one of those that did not arrive was with the chosen set.
    #[serde(default)]
    pub chosen_did_not_arrive: bool,
    /// Lower end of the 95 % interval of the share of those beyond, by Clopper and Pearson.
    pub beyond_low: f64,
    /// Upper end of it.
    pub beyond_high: f64,
    /// The largest distance from the path in any drive of the vehicle.
    pub worst_m: f64,
    /// The set that was chosen.
    pub chosen: OfDrives,
    /// Its largest distance from the path on the plants that chose it.
    pub chosen_simulated_worst_m: f64,
    /// The set of the law that a textbook, or the paper, would have.
    pub textbook: TextbookDriven,
    /// After so many drives no set was expected to be better by more than 1 %; null if there was still one.
    pub could_stop_after: Option<u32>,
    /// The chosen set on plants that chose nothing.
    pub fresh: FreshDrives,
}

/// What is thought of a set after its drives.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OfDrives {
    /// How often the vehicle drove it.
    pub drives: u64,
    /// Value of the objective, by the process that simulated and real drives make together.
    pub predicted: f64,
    /// Lower end of its 95 % interval, if the car is like the plants.
    pub low: f64,
    /// Upper end of it.
    pub high: f64,
}

/// The textbook's set of the tuned law.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TextbookDriven {
    /// The set.
    #[schemars(with = "ParameterTable")]
    pub gains: NamedParameters,
    /// Whether it is the set that was chosen.
    pub is_chosen: bool,
    /// Its largest distance from the path on the simulated plants.
    pub simulated_worst_m: f64,
    /// What its drives say; null if it was not driven: there were too few drives, or it is too far from the path.
    pub driven: Option<OfDrives>,
}

/// A set on plants that were drawn anew, and chose nothing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FreshDrives {
    /// How many.
    pub plants: usize,
    /// Sets beside it, among which the best one on each plant is looked for.
    pub compared: usize,
    /// On how many plants it was farther from the path than `within_m`.
    pub beyond: u64,
    /// Lower end of the 95 % interval of their share, by Clopper and Pearson.
    pub beyond_low: f64,
    /// Upper end of it.
    pub beyond_high: f64,
    /// On how many it did not arrive at the end of the path.
    pub not_arrived: u64,
    /// The largest distance from the path.
    pub path_max_m: f64,
    /// The mean distance from the path that 95 % of the plants do not exceed.
    pub path_mean_p95_m: f64,
    /// How much farther from the path on average than with the best set on the same plant: the median.
    pub off_best_median_m: f64,
    /// What 95 % of the plants do not exceed.
    pub off_best_p95_m: f64,
    /// How much more the objective is than with that set, as a share: the median.
    pub regret_median: f64,
    /// What 95 % of the plants do not exceed.
    pub regret_p95: f64,
}
