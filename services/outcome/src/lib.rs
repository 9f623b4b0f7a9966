//! What `result.json` holds: one type for the trainer that writes it, and for the orchestrator and the report that read it.
//!
//! A result has two parts. [`Decided`] is the part that is determined by configuration and seed: the same bytes for the
//! same digest. It is also written as `outcome.json`, so that it can be compared and cached. [`Run`] is the part that
//! differs from run to run.
//!
//! `pathtune schema --result` prints the doc comments of the fields.

mod baselines;
mod comparison;
mod drive;
mod file;
mod grid;
mod laps;
mod plants;
mod recording;
mod run;
mod simulated;
mod training;
mod validation;

use std::collections::BTreeMap;

use config::{NamedParameters, ObjectiveLimits};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use baselines::{Baseline, Baselines, TradeOff, TradedSet};
pub use comparison::{
    AfterDrives, CompareResult, CompareRow, CompareSubject, Compared, Course, DrivesTo, Quantile,
    Share, StudyComparison, TunerComparison, TunerCourses,
};
pub use drive::{Fastest, InEnvelope, QualityAt, RefusedSwitch, SingleDrive};
pub use file::{OUTCOME_FILE, OutcomeError, RESULT_FILE, read_decided, read_result, to_json};
pub use grid::{Flatness, GridResult, MainEffect, NamedSet, RankedSet, ValueMean};
pub use laps::{Alike, Lap, alike};
pub use plants::{Alternative, Extent, FreshPlants, Margin, PlantCheck, PlantDrive};
pub use recording::{RecordingFacts, TopicCounts};
pub use run::{DeathToTick, Drives, ProcessFacts, Recovery, Run, RunDrives};
pub use simulated::{FreshDrives, OfDrives, SimulatedFirst, TextbookDriven};
pub use training::{
    Beside, Comparison, Finalist, GridStanding, Interval, LearnerSummary, NoiseChoice, SetStanding,
    Spread, TrainResult, Usage, VehicleDrives, Verdict,
};
pub use validation::{NoiseFree, Noisy, Switch, ValidateResult, ValidatedRow};

/// The version of `result.json`.
pub const SCHEMA: u32 = 2;

/// The result of a run: `result.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RunResult {
    /// The part that is determined by configuration and seed.
    #[serde(flatten)]
    pub decided: Decided,
    /// The drives; with `run.memo` off, each one that is asked for is driven.
    pub drives: Drives,
    /// The part that differs from run to run.
    pub run: Run,
    /// The processes of the run, as in `run.processes`.
    pub processes: Vec<ProcessFacts>,
    /// Seconds of driving per second of the run, as in `run.real_time_factor`.
    pub real_time_factor: f64,
}

/// The part that is determined by configuration and seed: `outcome.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Decided {
    /// Version of this schema.
    pub schema: u32,
    /// The manoeuvre that was driven; `path` for a path of the user's own.
    pub maneuver: String,
    /// Name of the vehicle that the configuration describes.
    pub vehicle: String,
    /// The control law.
    pub law: String,
    /// The objective by which drives were judged.
    pub objective: String,
    /// Seed of the run.
    pub seed: u64,
    /// The result of the run; the key `kind` says of which kind it is.
    #[serde(flatten)]
    pub outcome: Outcome,
}

/// The result of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Outcome {
    /// A training.
    Train(Box<TrainResult>),
    /// A validation.
    Validate(ValidateResult),
    /// A sweep of the grid.
    Grid(GridResult),
    /// A single drive.
    Drive(Box<SingleDrive>),
}

impl Outcome {
    /// The digest of the drives on which it is based.
    pub fn digest(&self) -> &str {
        match self {
            Self::Train(it) => &it.digest,
            Self::Validate(it) => &it.digest,
            Self::Grid(it) => &it.digest,
            Self::Drive(it) => &it.digest,
        }
    }

    /// Ticks that recorded drives lack, by their names.
    pub fn drives_lacking(&self) -> &BTreeMap<String, u64> {
        static NONE: BTreeMap<String, u64> = BTreeMap::new();
        match self {
            Self::Train(it) => &it.drives_lacking,
            Self::Validate(it) => &it.drives_lacking,
            Self::Grid(_) => &NONE,
            Self::Drive(it) => &it.drives_lacking,
        }
    }

    /// The laps of recorded drives, by their names; empty if the path is driven once.
    pub fn laps(&self) -> &BTreeMap<String, Vec<Lap>> {
        static NONE: BTreeMap<String, Vec<Lap>> = BTreeMap::new();
        match self {
            Self::Train(it) => &it.laps,
            Self::Validate(it) => &it.laps,
            Self::Grid(_) => &NONE,
            Self::Drive(it) => &it.laps,
        }
    }

    /// The value of the key `kind`.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Train(_) => "train",
            Self::Validate(_) => "validate",
            Self::Grid(_) => "grid",
            Self::Drive(_) => "drive",
        }
    }
}

/// The measures of one drive, noise-free unless the context says otherwise.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Measures {
    /// Value of the objective; the smaller the better.
    pub value: f64,
    /// Distance of the mean cross-track and heading error to 0 (the paper's equation 4).
    pub distance: f64,
    /// Mean of half the squared tracking error, m² (the paper's equation 6).
    pub mse_m2: f64,
    /// Mean distance of the true pose, or of the measured one if the true pose is unknown, from the nearest point of
    /// the path.
    pub path_mean_m: f64,
    /// Its 95th percentile.
    pub path_p95_m: f64,
    /// Its largest value.
    pub path_max_m: f64,
    /// Mean absolute rate of the commanded steering angle.
    #[serde(default)]
    pub steering_travel_radps: f64,
    /// The absolute rate of the commanded steering angle that 95 % of the ticks do not exceed.
    #[serde(default)]
    pub steering_rate_p95_radps: f64,
    /// The absolute lateral acceleration that 95 % of the ticks do not exceed: speed times yaw rate.
    #[serde(default)]
    pub lateral_acceleration_p95_mps2: f64,
    /// Its largest value.
    #[serde(default)]
    pub lateral_acceleration_max_mps2: f64,
    /// The absolute change of the lateral acceleration over 0.1 s, a second, that 95 % of the times do not exceed.
    #[serde(default)]
    pub lateral_jerk_p95_mps3: f64,
    /// Its largest value.
    #[serde(default)]
    pub lateral_jerk_max_mps3: f64,
    /// Share of the path, 0 to 1, that had been covered when the reference reached its end, or when the drive ended if
    /// that was earlier.
    #[serde(default)]
    pub progress_in_time: f64,
    /// Whether the drive ended at the end of the path.
    pub arrived: bool,
}

impl Measures {
    /// The limits that they break, each with its key below `objective.limits`, what was measured, and the limit.
    pub fn broken_limits(&self, limits: &ObjectiveLimits) -> Vec<(&'static str, f64, f64)> {
        let at_most = [
            ("steering_travel_radps", self.steering_travel_radps, limits.steering_travel_radps),
            (
                "steering_rate_p95_radps",
                self.steering_rate_p95_radps,
                limits.steering_rate_p95_radps,
            ),
            (
                "lateral_acceleration_p95_mps2",
                self.lateral_acceleration_p95_mps2,
                limits.lateral_acceleration_p95_mps2,
            ),
            (
                "lateral_acceleration_max_mps2",
                self.lateral_acceleration_max_mps2,
                limits.lateral_acceleration_max_mps2,
            ),
            ("lateral_jerk_p95_mps3", self.lateral_jerk_p95_mps3, limits.lateral_jerk_p95_mps3),
            ("lateral_jerk_max_mps3", self.lateral_jerk_max_mps3, limits.lateral_jerk_max_mps3),
        ];
        let broken = at_most.into_iter().filter(|(_, value, limit)| *limit > 0.0 && value > limit);
        let lags = self.progress_in_time < limits.progress;
        broken.chain(lags.then_some(("progress", self.progress_in_time, limits.progress))).collect()
    }
}

/// The schema of named parameters: a table of numbers.
pub(crate) type ParameterTable = std::collections::BTreeMap<String, f64>;

/// Named parameters that were read, checked against a law.
///
/// # Errors
/// If they are not that law's parameters.
pub fn parameters_of(
    law: &config::LawConfig,
    named: &NamedParameters,
) -> Result<config::Parameters, String> {
    law.parameters_of(named).map_err(|(key, problem)| format!("{key}: {problem}"))
}

/// The JSON Schema of `result.json`.
pub fn schema() -> String {
    let schema = schemars::schema_for!(RunResult);
    serde_json::to_string_pretty(&schema).expect("a schema is plain data")
}
