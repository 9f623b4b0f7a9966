//! The result of a sweep of the grid.

use std::collections::BTreeMap;

use config::NamedParameters;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Measures, ParameterTable, PlantCheck};

/// The result of a sweep of the grid; `grid.csv` holds every set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GridResult {
    /// SHA-256 over the reports of all drives.
    pub digest: String,
    /// Number of sets.
    pub size: usize,
    /// The best sets by the objective.
    pub best: Vec<RankedSet>,
    /// The best sets by the distance.
    pub best_by_distance: Vec<RankedSet>,
    /// The best sets by the mse.
    pub best_by_mse: Vec<RankedSet>,
    /// The best sets by the mean distance from the path.
    pub best_by_path: Vec<RankedSet>,
    /// The paper's set, and the sets that the user gave.
    pub sets: Vec<NamedSet>,
    /// How many sets lie near the best one.
    pub flatness: Vec<Flatness>,
    /// What the best set by the objective does on plausible plants, and whether it is fragile; null with a vehicle that is
    /// not our simulator, and in results of earlier versions.
    #[serde(default)]
    pub plants: Option<Box<PlantCheck>>,
    /// What each parameter alone explains, by its name.
    pub main_effects: BTreeMap<String, MainEffect>,
}

/// A set of the grid, with its ranks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RankedSet {
    /// The set.
    #[schemars(with = "ParameterTable")]
    pub gains: NamedParameters,
    /// The measures of a drive with it.
    #[serde(flatten)]
    pub measures: Measures,
    /// Whether it lies between the sets of the grid: then it is ranked as if the grid had one set more.
    #[serde(default)]
    pub off_grid: bool,
    /// 1 + the number of sets with a smaller value of the objective.
    pub rank_value: usize,
    /// 1 + the number of sets with a smaller distance.
    pub rank_distance: usize,
    /// 1 + the number of sets with a smaller mse.
    pub rank_mse: usize,
    /// 1 + the number of sets with a smaller mean distance from the path.
    pub rank_path: usize,
    /// Names of the parameters that lie on a bound of the grid.
    pub on_bound: Vec<String>,
}

/// A set that was asked for by name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NamedSet {
    /// Its name: `paper` or `yours`.
    pub name: String,
    /// The set.
    #[serde(flatten)]
    pub set: RankedSet,
}

/// How many sets lie near the best one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Flatness {
    /// Sets count if they exceed the best by at most this share of it.
    pub within: f64,
    /// Number of sets by the objective.
    pub sets_by_value: usize,
    /// Number of sets by the distance.
    pub sets_by_distance: usize,
    /// Number of sets by the mse.
    pub sets_by_mse: usize,
    /// Number of sets by the mean distance from the path.
    pub sets_by_path: usize,
}

/// What one parameter alone explains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MainEffect {
    /// Share of the objective's variance over the grid that the means of the parameter's values explain (η²).
    pub share_value: f64,
    /// The same for the distance.
    pub share_distance: f64,
    /// The same for the mse.
    pub share_mse: f64,
    /// The same for the mean distance from the path.
    pub share_path: f64,
    /// The means.
    pub values: Vec<ValueMean>,
}

/// Means over all sets in which a parameter has one value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ValueMean {
    /// The value.
    pub value: f64,
    /// Mean of the objective.
    pub mean_value: f64,
    /// Mean distance.
    pub mean_distance: f64,
    /// Mean of the mse.
    pub mean_mse_m2: f64,
    /// Mean of the mean distance from the path.
    pub mean_path_m: f64,
}
