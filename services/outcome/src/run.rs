//! The part of a result that differs from run to run.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::RecordingFacts;

/// The part of a result that differs from run to run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Run {
    /// What was driven when the run was stopped before its end, as in `3.2 s` or `2 of 5 sets`; null if it was not.
    #[serde(default)]
    pub stopped_after: Option<String>,
    /// Version of pathtune that made the run.
    pub pathtune: String,
    /// The command line, word by word.
    pub command: Vec<String>,
    /// When the run began (RFC 3339).
    pub started_at: String,
    /// When it ended (RFC 3339).
    pub ended_at: String,
    /// Seconds in between.
    pub wall_s: f64,
    /// Seconds that the vehicles drove.
    pub vehicle_s: f64,
    /// Seconds of driving per second of the run.
    pub real_time_factor: f64,
    /// The drives that the processes made.
    pub drives: RunDrives,
    /// The processes, in the order in which they started.
    pub processes: Vec<ProcessFacts>,
    /// The recording, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording: Option<RecordingFacts>,
    /// Faults that were injected, and how long recoveries took.
    pub recovery: Recovery,
    /// Mean time of a tick from the request of a batch to its report, in nanoseconds.
    pub tick_ns: f64,
    /// How the processes waited for each other: `yield`, `spin` or `block`.
    pub waiting: String,
    /// How many rings shared the drives.
    #[serde(default = "one")]
    pub rings: usize,
}

/// Results of earlier versions were driven in one ring.
fn one() -> usize {
    1
}

/// The drives of a run, whatever was killed or resumed on the way.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Drives {
    /// Drives that were asked for.
    pub asked: u64,
    /// Those that were driven rather than answered from memory.
    pub driven: u64,
    /// Drives beside them that a training made for its table alone: with a vehicle that is not our simulator.
    #[serde(default)]
    pub for_table: u64,
}

/// The drives that the processes of one run made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RunDrives {
    /// Drives that were reported, without those of the earlier part of a resumed run.
    pub reported: u64,
    /// Drives outside the training: of finalists, for the table, and of the tuned set for its recordings.
    pub beside: u64,
    /// Drives that were made again after a crash.
    pub reissued: u64,
}

/// One process of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProcessFacts {
    /// Name of its role.
    pub name: String,
    /// Its process id, that of its last start.
    pub pid: u32,
    /// How often it was started again.
    pub restarts: u32,
    /// Samples that belonged to another run, batch, attempt or tick, and were dropped.
    pub dropped: u64,
    /// Samples that were not finite or out of range, and were rejected.
    pub rejected: u64,
    /// Samples that came too late in real time.
    pub late: u64,
}

/// Faults and recoveries of a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Recovery {
    /// Faults that were caused on purpose.
    pub injected: u64,
    /// Batches that were driven again although no process had died.
    pub stalls: u64,
    /// How many times ticks began to flow again.
    pub recoveries: u64,
    /// Milliseconds from a death to the next tick.
    pub death_to_tick_ms: DeathToTick,
}

/// Percentiles of a time; null if there was no recovery.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DeathToTick {
    /// Its median.
    pub p50: Option<f64>,
    /// Its 99th percentile.
    pub p99: Option<f64>,
    /// Its largest value.
    pub max: Option<f64>,
}
