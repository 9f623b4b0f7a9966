//! The result of a training.

use std::collections::BTreeMap;

use config::NamedParameters;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{
    Baselines, Lap, Measures, OfDrives, ParameterTable, PlantCheck, SimulatedFirst, TradeOff,
};

/// The result of a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrainResult {
    /// The tuner.
    pub tuner: String,
    /// SHA-256 over what each learner received and became.
    pub digest: String,
    /// The tuned parameters, by their names in the law.
    #[schemars(with = "ParameterTable")]
    pub gains: NamedParameters,
    /// Names of the parameters that lie on a bound of the grid.
    pub on_bound: Vec<String>,
    /// The measures of a drive with them, without noise; means if the vehicle does not repeat itself.
    #[serde(flatten)]
    pub measures: Measures,
    /// How certain these means are; null for a single drive.
    #[serde(default)]
    pub spread: Option<Spread>,
    /// Whether the set lies between the sets of the grid: then it is ranked as if the grid had one set more.
    #[serde(default)]
    pub off_grid: bool,
    /// The drives from which the figures come, if vehicle, controller or supervisor are not ours; null if the figures were
    /// computed with our simulator.
    #[serde(default)]
    pub vehicle_drives: Option<VehicleDrives>,
    /// Their standing among all sets of the grid; null if the grid was not driven: it takes too many ticks, or the vehicle
    /// paces by the clock.
    pub grid: Option<GridStanding>,
    /// The set that the paper chose for this manoeuvre; null for another law or path.
    pub paper: Option<SetStanding>,
    /// The same training by plain Q-learning, on drives of the grid; null if the grid was not driven.
    pub plain_q: Option<Beside>,
    /// The same training by a random walk, on drives of the grid; null if the grid was not driven.
    pub random_walk: Option<Beside>,
    /// The set on plausible plants, in our simulator whatever vehicle drove; null in results of earlier versions with a
    /// vehicle of the user's.
    #[serde(default)]
    pub plants: Option<PlantCheck>,
    /// The textbook sets beside it; null where path and car are the paper's, whose figures are the yardstick there, and
    /// for a vehicle that is not our simulator, which drives the tuned law alone.
    #[serde(default)]
    pub baselines: Option<Baselines>,
    /// What less distance costs in turning the wheels, over the grid; null if the grid was not driven.
    #[serde(default)]
    pub trade_off: Option<TradeOff>,
    /// How the set was chosen by means over several drives: under noise, or with a vehicle that does not repeat itself;
    /// otherwise null.
    pub noise: Option<NoiseChoice>,
    /// What the tuner's model says of the set under noise, where the budget is below 30 drives: in place of finalists, which
    /// would take further drives; null otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub predicted: Option<OfDrives>,
    /// After so many of its drives the tuner neither found nor expected a set that is better by more than 1 %; null if it
    /// did until its end, or cannot tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub could_stop_after: Option<u32>,
    /// What many simulated plants and few drives say together; null if nothing was simulated first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulated_first: Option<SimulatedFirst>,
    /// Drives that the learners asked for.
    pub asked: u64,
    /// Different drives among them: those that a memory does not answer.
    pub distinct: u64,
    /// A summary of how each learner learnt; `episodes.csv` and `drives.csv` hold the details.
    pub learners: Vec<LearnerSummary>,
    /// Drives with the tuned parameters whose recordings are in the run's folder `drives`.
    pub drives_recorded: Vec<String>,
    /// Ticks that a recorded drive lacks, by its name: by the clock, a process that is held up leaves ticks out.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub drives_lacking: BTreeMap<String, u64>,
    /// The laps of each recorded drive, by its name, where a closed path is driven several times.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub laps: BTreeMap<String, Vec<Lap>>,
}

/// The drives from which figures come, where they are not those of our simulator. All of them are without noise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct VehicleDrives {
    /// Whether the same request gives the same drive. If not, figures are means, and another training of the same seed
    /// comes to another result.
    pub repeats: bool,
    /// Whether the vehicle paces by the clock.
    pub by_clock: bool,
    /// Drives that were made for the table alone.
    pub for_table: u64,
    /// Drives of each set of the grid; 0 if the grid was not driven.
    pub of_grid_set: u32,
}

/// How certain the means over several drives of a set are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Spread {
    /// Number of drives.
    pub drives: u32,
    /// Of the objective's mean.
    pub value: Interval,
    /// Of the mean distance.
    pub distance: Interval,
    /// Of the mean mse.
    pub mse_m2: Interval,
    /// Of the mean of the mean distance from the path.
    pub path_mean_m: Interval,
}

/// The 95 % bootstrap interval of a mean.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Interval {
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
}

/// The standing of the tuned set among all sets of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GridStanding {
    /// Number of sets.
    pub size: usize,
    /// 1 + the number of sets with a smaller value of the objective.
    pub rank_value: usize,
    /// 1 + the number of sets with a smaller distance.
    pub rank_distance: usize,
    /// 1 + the number of sets with a smaller mse.
    pub rank_mse: usize,
    /// 1 + the number of sets with a smaller mean distance from the path.
    pub rank_path: usize,
    /// Rank by the mean of the objective over noise seeds that were not used before; null without noise, and with a vehicle
    /// that is not our simulator.
    pub rank_mean: Option<usize>,
    /// Least value of the objective.
    pub best_value: f64,
    /// Least distance.
    pub best_distance: f64,
    /// Least mse.
    pub best_mse_m2: f64,
    /// Least mean distance from the path.
    pub best_path_mean_m: f64,
}

/// A set beside the tuned one, driven without noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SetStanding {
    /// The set.
    #[schemars(with = "ParameterTable")]
    pub gains: NamedParameters,
    /// The measures of a drive with it; means if the vehicle does not repeat itself.
    #[serde(flatten)]
    pub measures: Measures,
    /// How certain these means are; null for a single drive.
    #[serde(default)]
    pub spread: Option<Spread>,
    /// Whether it lies between the sets of the grid: then it is ranked as if the grid had one set more.
    #[serde(default)]
    pub off_grid: bool,
    /// 1 + the number of sets of the grid with a smaller value of the objective.
    pub rank_value: Option<usize>,
    /// 1 + the number of sets of the grid with a smaller distance.
    pub rank_distance: Option<usize>,
    /// 1 + the number of sets of the grid with a smaller mse.
    pub rank_mse: Option<usize>,
    /// 1 + the number of sets of the grid with a smaller mean distance from the path.
    pub rank_path: Option<usize>,
}

/// The same training by another tuner, on noise-free drives of the grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Beside {
    /// The set that it recommends.
    #[serde(flatten)]
    pub set: SetStanding,
    /// Drives that it asked for.
    pub asked: u64,
    /// Number of different sets among them: drives that memory does not answer.
    pub distinct: u64,
}

/// How one learner learnt.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LearnerSummary {
    /// Its learning rate; null for tuners that have none.
    pub alpha: Option<f64>,
    /// The set that it picks.
    #[schemars(with = "ParameterTable")]
    pub gains: NamedParameters,
    /// Parameters that it locked, with their values.
    pub locked: BTreeMap<String, f64>,
    /// How often each value of each parameter was driven; empty for tuners that do not use the grid.
    pub usage: BTreeMap<String, Vec<Usage>>,
    /// Drives that it received.
    pub drives: u32,
    /// Its episodes; 0 for tuners that have none.
    pub episodes: u32,
    /// Episodes that reached a terminal state.
    pub terminated: u32,
    /// Least value of the objective that it saw.
    pub best: Option<f64>,
}

/// How often a parameter had a value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Usage {
    /// The value.
    pub value: f64,
    /// Drives with it.
    pub count: u64,
}

/// How the set was chosen by several drives: under noise, over plants, or with a vehicle that does not repeat itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NoiseChoice {
    /// Drives of each finalist over which means, intervals and differences are taken; under noise and over plants none of
    /// them chose. In a training over plants each is on a plant that was drawn anew.
    pub repeats: u64,
    /// Drives of each finalist by which one was chosen; over plants each is on a plant that was drawn anew.
    #[serde(default)]
    pub choosing: u64,
    /// Noise seeds over which the chosen set is ranked.
    pub holdout: u32,
    /// The sets that were driven again, in the order of the drives that chose; the first one is chosen.
    pub finalists: Vec<Finalist>,
    /// The chosen set against the one that the tuner recommends by single drives.
    pub against_recommended: Comparison,
    /// The chosen set against the paper's.
    pub against_paper: Option<Comparison>,
}

/// A set that was driven again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Finalist {
    /// The set.
    #[schemars(with = "ParameterTable")]
    pub gains: NamedParameters,
    /// Mean of the objective over its drives.
    pub mean_value: f64,
    /// Lower end of the mean's 95 % interval, by Student's t.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
    /// Drives of the training with this set.
    pub visits: u32,
    /// Over plants, and where drives are to arrive: the plants among those that chose with which it did not.
    #[serde(default)]
    pub not_arrived: u64,
    /// Over plants: whether the set is fragile, and therefore ranks behind those that are not.
    #[serde(default)]
    pub fragile: bool,
}

/// The chosen set against another one, by drives with the same noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Comparison {
    /// The other set.
    #[schemars(with = "ParameterTable")]
    pub gains: NamedParameters,
    /// Mean difference of the objective: below 0 if the chosen set is better.
    pub difference: f64,
    /// Lower end of its 95 % bootstrap interval.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
    /// `better` or `worse` if the interval excludes 0, otherwise `undecided`.
    pub verdict: Verdict,
}

/// What a paired difference says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The interval of the difference lies below 0.
    Better,
    /// It lies above 0.
    Worse,
    /// It contains 0.
    Undecided,
}
