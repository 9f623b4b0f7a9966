//! The result of a validation: sets compared with the paper's, without noise and with it.

use std::collections::BTreeMap;

use config::NamedParameters;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Lap, Measures, ParameterTable, PlantCheck};

/// The result of a validation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ValidateResult {
    /// SHA-256 over the reports of all drives.
    pub digest: String,
    /// Noisy drives of each row.
    pub repeats: u64,
    /// The rows.
    pub rows: Vec<ValidatedRow>,
    /// exp of the root mean square of ln(ours / paper's), over all figures that the paper has.
    pub rms_factor: Option<f64>,
    /// Drives whose recordings are in the run's folder `drives`.
    pub drives_recorded: Vec<String>,
    /// Ticks that a recorded drive lacks, by its name: by the clock, a process that is held up leaves ticks out.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub drives_lacking: BTreeMap<String, u64>,
    /// The laps of each recorded drive, by its name, where a closed path is driven several times.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub laps: BTreeMap<String, Vec<Lap>>,
}

/// One set, or one set for each manoeuvre of the path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ValidatedRow {
    /// The set of each manoeuvre, or one for all.
    #[schemars(with = "Vec<ParameterTable>")]
    pub gains: Vec<NamedParameters>,
    /// Whether the paper chose this row.
    pub chosen_by_paper: bool,
    /// The drive without noise.
    pub noise_free: NoiseFree,
    /// The drives with noise.
    pub noisy: Noisy,
    /// The set on plausible plants; null for several sets, or where another vehicle than our simulator drove.
    #[serde(default)]
    pub plants: Option<PlantCheck>,
    /// Where the parameters changed, in the drive without noise.
    pub switches: Vec<Switch>,
}

/// The drive without noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NoiseFree {
    /// Its measures.
    #[serde(flatten)]
    pub measures: Measures,
    /// Along-track share of the mse.
    pub along_m2: f64,
    /// Cross-track share of the mse.
    pub cross_m2: f64,
    /// Largest absolute cross-track error against the current reference.
    pub max_cross_track_m: f64,
    /// Share of the ticks on which the steering angle was at its limit.
    pub steering_limited: f64,
    /// 1 if the drive ended in a collision, else 0.
    pub collisions: u32,
    /// Share of the drive's time after which it ended: in a collision, at the goal, or by time.
    pub driven: f64,
    /// The paper's mse.
    pub paper_mse_m2: Option<f64>,
    /// Ours over the paper's, or the paper's over ours: 1 or more.
    pub factor: Option<f64>,
}

/// The drives with noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Noisy {
    /// Mean of the mse.
    pub mse_m2_mean: f64,
    /// Lower end of the mean's 95 % bootstrap interval.
    pub mse_m2_low: f64,
    /// Its upper end.
    pub mse_m2_high: f64,
    /// Largest mse.
    pub mse_m2_worst: f64,
    /// Mean of the mean distance from the path.
    pub path_mean_m: f64,
    /// Largest distance from the path in any of the drives.
    pub path_max_m: f64,
    /// Drives that ended in a collision.
    pub collisions: u32,
    /// The paper's worst mse.
    pub paper_mse_m2: Option<f64>,
    /// The worst over the paper's worst, or the other way round: 1 or more.
    pub factor: Option<f64>,
}

/// A change of the parameters with the zone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Switch {
    /// The first tick with the new parameters.
    pub tick: u64,
    /// Number of the zone along the path.
    pub zone: u32,
    /// Name of its manoeuvre.
    pub name: String,
    /// The new parameters.
    #[schemars(with = "ParameterTable")]
    pub gains: NamedParameters,
}
