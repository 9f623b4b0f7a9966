//! Tuners compared over many seeds: what `pathtune compare` prints.

use config::NamedParameters;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ParameterTable;

/// Tuners that were given the same manoeuvre, budget and seeds. Every interval is one of 95 %.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CompareResult {
    /// Version of this schema.
    pub schema: u32,
    /// The manoeuvre that was driven; `path` for a path of the user's own.
    pub maneuver: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// Name of the law whose parameters were tuned.
    pub law: String,
    /// Name of the objective.
    pub objective: String,
    /// The first seed; the others follow it.
    pub first_seed: u64,
    /// Number of seeds.
    pub seeds: u64,
    /// Budget of each training, in drives.
    pub drives: u32,
    /// Whether the odometry was noisy.
    pub noise: bool,
    /// Number of plants on which each set is driven, which counts as one drive; 1 for the vehicle as its file has it.
    #[serde(default = "one")]
    pub plants: usize,
    /// A set's true value is the mean over so many drives that no tuner saw, over plants so many on each; 1 without noise.
    /// Of the sets that seem nearly as good as the best, it is that over 480 others, over plants over 16 on each.
    pub drives_of_truth: u64,
    /// Number of sets in the grid.
    pub grid_size: usize,
    /// The least true value of all sets of the grid, and of all others that a tuner drove or recommended.
    pub best_value: f64,
    /// The set with that value.
    #[schemars(with = "ParameterTable")]
    pub best_gains: NamedParameters,
    /// The tuners, in the order in which they were named.
    pub tuners: Vec<TunerComparison>,
}

fn one() -> usize {
    1
}

/// How one tuner did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TunerComparison {
    /// Its name.
    pub tuner: String,
    /// Drives until one of the sets that it drove was truly within 2 % of the best value.
    pub to_within_2_percent: DrivesTo,
    /// Drives until one of the sets that it drove was truly as good as the best 1 % of the grid.
    pub to_top_1_percent: DrivesTo,
    /// What it recommended after some drives.
    pub after: Vec<AfterDrives>,
}

/// Drives that it takes to reach a goal. Memory's answers count as none.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DrivesTo {
    /// The seeds that reached it within the budget.
    pub reached: Share,
    /// Half of the seeds needed no more than these.
    pub median: Quantile,
    /// 95 % of the seeds needed no more than these.
    pub q95: Quantile,
}

/// The set that a tuner recommends after some drives.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AfterDrives {
    /// The drives.
    pub drives: u32,
    /// Regret: by which share of the best value the set's true value is above it. Its median over the seeds.
    pub regret_median: Quantile,
    /// The regret that 95 % of the seeds do not exceed.
    pub regret_q95: Quantile,
    /// The seeds whose set is truly within 5 % of the best value.
    pub within_5_percent: Share,
}

/// A quantile over the seeds, with the interval of its order statistics: it supposes nothing of their distribution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Quantile {
    /// The quantile; null if it lies beyond the budget.
    pub value: Option<f64>,
    /// Lower end of its interval; null if it is open, or lies beyond the budget.
    pub low: Option<f64>,
    /// Upper end of its interval; null if it is open, or lies beyond the budget.
    pub high: Option<f64>,
}

/// A share of the seeds, with Wilson's interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Share {
    /// Number of seeds.
    pub count: u64,
    /// That number, divided by that of all seeds.
    pub share: f64,
    /// Lower end of its interval.
    pub low: f64,
    /// Upper end of its interval.
    pub high: f64,
}

/// One training of a comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CompareRow {
    /// The tuner.
    pub tuner: String,
    /// The seed.
    pub seed: u64,
    /// As [`TunerComparison::to_within_2_percent`]; `None` beyond the budget.
    pub to_within_2_percent: Option<u32>,
    /// As [`TunerComparison::to_top_1_percent`]; `None` beyond the budget.
    pub to_top_1_percent: Option<u32>,
    /// The regret of what it recommends after each of [`TunerComparison::after`].
    pub regret: Vec<f64>,
}
