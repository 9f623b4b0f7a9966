//! The result of a single drive.

use std::collections::BTreeMap;

use config::NamedParameters;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Lap, Measures, ParameterTable, Switch};

/// The result of a single drive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SingleDrive {
    /// SHA-256 over the drive's report; in real time, every drive has a different one.
    pub digest: String,
    /// The set of each manoeuvre, or one for all.
    #[schemars(with = "Vec<ParameterTable>")]
    pub gains: Vec<NamedParameters>,
    /// Why it ended: `time`, `goal`, `collision`, `held` (the vehicle did not follow) or `stopped` (by the gate).
    pub reason: String,
    /// What the gate stopped the vehicle for.
    #[serde(default)]
    pub stopped_for: Vec<String>,
    /// How the gate stopped it: `rest` (its reference came to rest, and it followed), `brake` (a full brake, steered by the
    /// law) or `brake_straight` (a full brake, its wheels straight); null if it did not.
    #[serde(default)]
    pub stopped_how: Option<String>,
    /// What the gate slowed the vehicle down for, or only told.
    #[serde(default)]
    pub slowed_for: Vec<String>,
    /// Seconds that were driven, without stops.
    pub driven_s: f64,
    /// Share of the path, 0 to 1, that had been covered when it ended.
    pub progress: f64,
    /// Its measures.
    #[serde(flatten)]
    pub measures: Measures,
    /// Along-track share of the mse.
    pub along_m2: f64,
    /// Cross-track share of the mse.
    pub cross_m2: f64,
    /// Mean absolute cross-track error against the current reference.
    pub mean_abs_cross_track_m: f64,
    /// Its largest value.
    pub max_cross_track_m: f64,
    /// Where it drove fastest, compared with the speed of the path there; null if nothing of it was recorded.
    #[serde(default)]
    pub fastest: Option<Fastest>,
    /// Whether the poses are true ones, which only a simulator knows; otherwise they are measured ones.
    pub true_poses: bool,
    /// Whether the controller was restarted during the drive: then the measures cover the time since.
    pub joined: bool,
    /// Where it was in its envelope, if it was held to one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub envelope: Option<InEnvelope>,
    /// Where the parameters changed.
    pub switches: Vec<Switch>,
    /// Where changes of the parameters were put off, because the new ones were not certain to hold the vehicle as it drove.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub refused: Vec<RefusedSwitch>,
    /// The name of its recording in the run's folder `drives`.
    pub drives_recorded: Vec<String>,
    /// Ticks that a recorded drive lacks, by its name: by the clock, a process that is held up leaves ticks out.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub drives_lacking: BTreeMap<String, u64>,
    /// The laps of each recorded drive, by its name, where a closed path is driven several times.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub laps: BTreeMap<String, Vec<Lap>>,
}

/// How well it tracked at a moment, beside calibrated drives.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct QualityAt {
    /// The moment, in seconds from the start.
    pub at_s: f64,
    /// The quality q = 1/(1 + √(Ē_y² + 10 Ē_θ²)), with the mean absolute lateral and heading errors of the last second.
    pub observed: f64,
    /// Its mean over the calibrated drives, as long after take-off; null where few of them lasted as long.
    pub calibrated: Option<f64>,
    /// Its standard deviation over them.
    pub sd: Option<f64>,
}

/// A change of the parameters that was put off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RefusedSwitch {
    /// The first tick at which it was due.
    pub from_tick: u64,
    /// The tick from which on it was no longer refused; null if the drive ended before.
    pub until_tick: Option<u64>,
}

/// A drive in its envelope.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct InEnvelope {
    /// Its score: how far it was from the drives that were calibrated on.
    pub score: f64,
    /// Above this score it is out of the envelope.
    pub threshold: f64,
    /// What the score comes from: `quality`, `lateral_error`, `along`, `lateral`, `yaw`, `noise` or `heading_noise`.
    pub worst: String,
    /// Over how many seconds that was looked at.
    pub over_s: f64,
    /// When it was out of the envelope for the first time, in seconds from the start; null if it never was.
    pub out_at_s: Option<f64>,
    /// The tick of the odometry with which it was out.
    #[serde(default)]
    pub out_at_tick: Option<u64>,
    /// What of it was out by then: as `worst`.
    pub out_by: Option<String>,
    /// Over how many seconds that was looked at.
    #[serde(default)]
    pub out_over_s: Option<f64>,
    /// What the gate did about it: `rest`, `brake` or `brake_straight`, as `stopped_how`; null if the drive was only judged.
    #[serde(default)]
    pub action: Option<String>,
    /// The quality of tracking, every second.
    #[serde(default)]
    pub quality: Vec<QualityAt>,
}

/// A speed beside that of the path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Fastest {
    /// The vehicle's speed.
    pub speed_mps: f64,
    /// The speed at which that place of the path is to be passed.
    pub path_speed_mps: f64,
}
