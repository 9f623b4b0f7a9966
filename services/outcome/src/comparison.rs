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
    /// The true value of the law's textbook parameters; null where records of a study were made before it was read.
    #[serde(default)]
    pub textbook_value: Option<f64>,
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

impl Quantile {
    /// Drives, as in `9 [8, 11]`; what lies beyond the budget as in `> 60`, and a lower end that the seeds do not tell as a
    /// dash.
    pub fn as_drives(&self, budget: u32) -> String {
        let one = |value: Option<f64>| value.map_or(format!("> {budget}"), |it| it.to_string());
        let low = self.low.map_or("–".to_owned(), |it| it.to_string());
        match (self.value, self.low) {
            (None, None) => one(None),
            _ => format!("{} [{low}, {}]", one(self.value), one(self.high)),
        }
    }

    /// A share of something, as in `3.1 % [2.0, 4.4]`; an end that the seeds do not tell as a dash.
    pub fn as_percent(&self) -> String {
        let one =
            |value: Option<f64>| value.map_or("–".to_owned(), |it| format!("{:.1}", 100.0 * it));
        format!("{} % [{}, {}]", one(self.value), one(self.low), one(self.high))
    }
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

impl Share {
    /// As in `92 % [88, 95]`.
    pub fn as_percent(&self) -> String {
        let [share, low, high] =
            [self.share, self.low, self.high].map(|it| format!("{:.0}", 100.0 * it));
        format!("{share} % [{low}, {high}]")
    }
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
    /// Each drive whose set was truly better than those of all drives before: its number, from 1 on, and the set's regret.
    pub better: Vec<(u32, f64)>,
}

/// A comparison, and each of its trainings.
#[derive(Debug, Clone, PartialEq)]
pub struct Compared {
    /// What is printed.
    pub result: CompareResult,
    /// The trainings: tuner by tuner, seed by seed.
    pub rows: Vec<CompareRow>,
}

/// What all trainings of a comparison have in common.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CompareSubject {
    /// As [`CompareResult::maneuver`].
    pub maneuver: String,
    /// As [`CompareResult::vehicle`].
    pub vehicle: String,
    /// As [`CompareResult::law`].
    pub law: String,
    /// As [`CompareResult::objective`].
    pub objective: String,
}

/// A tuner with its trainings: the seed and the course of each.
pub type TunerCourses = (String, Vec<(u64, Course)>);

/// How one training went, by true values. Trainings that were made apart from each other can be compared by these alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Course {
    /// Its budget, in drives.
    pub drives: u32,
    /// As [`CompareResult::plants`].
    pub plants: usize,
    /// As [`CompareResult::drives_of_truth`].
    pub drives_of_truth: u64,
    /// Number of sets in the grid.
    pub grid_size: usize,
    /// The least true value of all sets of the grid, and of all others that this training drove or recommended.
    pub best_value: f64,
    /// The set with that value.
    pub best_gains: NamedParameters,
    /// As [`CompareResult::textbook_value`].
    #[serde(default)]
    pub textbook_value: Option<f64>,
    /// The true value of the worst set among the best 1 % of the grid.
    pub top_1_percent_value: f64,
    /// Each drive whose set was truly better than those of all drives before: its number, from 1 on, and the true value.
    pub better: Vec<(u32, f64)>,
    /// Drives after which it was asked what it recommends.
    pub marks: Vec<u32>,
    /// The true value of what it recommended after each of [`Course::marks`].
    pub recommended: Vec<f64>,
}

impl Course {
    /// Drives until one of the sets that it drove was truly as good as this value; `None` beyond the budget.
    pub fn drives_to(&self, value: f64) -> Option<u32> {
        self.better.iter().find(|(_, it)| *it <= value).map(|(number, _)| *number)
    }

    /// The true value of a set that is as good as within 2 % of the best.
    pub fn within_2_percent_value(best_value: f64) -> f64 {
        1.02 * best_value
    }

    /// By which share of the best value this one is above it.
    pub fn regret(value: f64, best_value: f64) -> f64 {
        // Under noise a set whose value is the mean over fewer drives may seem better than the best.
        (value / best_value - 1.0).max(0.0)
    }
}

/// Trainings of a study that differ in nothing but tuner and seed.
#[derive(Debug, Clone, PartialEq)]
pub struct StudyComparison {
    /// Values of the study's axes that only these trainings have, as in `set.noise.position_sd_m = 0.02`; may be empty.
    pub of: String,
    /// Tuners that are left out because jobs of theirs have no result.
    pub lacking: Vec<String>,
    /// The comparison.
    pub compared: Compared,
}
