//! `result.json`: what the trainer's role has found out, joined with what only the orchestrator knows.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use config::RunConfig;
use serde_json::{Map, Value, json};

use crate::pipeline::member::Refused;
use crate::pipeline::sequencer::Counts;

/// What only the orchestrator knows of a run.
pub(crate) struct RunFacts {
    pub(crate) counts: Counts,
    pub(crate) processes: Vec<ProcessFacts>,
    /// Faults and recoveries.
    pub(crate) recovery: Value,
    pub(crate) wall_s: f64,
    /// Mean time of a tick, from the request of a batch to its report.
    pub(crate) tick_ns: f64,
    /// How the processes waited for each other.
    pub(crate) waiting: &'static str,
}

/// One process.
pub(crate) struct ProcessFacts {
    pub(crate) name: &'static str,
    pub(crate) pid: u32,
    pub(crate) restarts: u32,
    pub(crate) refused: Refused,
}

/// Joins the outcome with what only the orchestrator knows, and writes `result.json`. `kind` is the command
/// that made the run.
pub(crate) fn write_result(
    folder: &Path,
    kind: &str,
    config: &RunConfig,
    facts: &RunFacts,
) -> Result<Value> {
    let outcome_path = folder.join("outcome.json");
    let text =
        fs::read(&outcome_path).with_context(|| format!("failed to read {outcome_path:?}"))?;
    let mut result: Map<String, Value> = serde_json::from_slice(&text)
        .with_context(|| format!("failed to parse {outcome_path:?}"))?;
    let counts = facts.counts;
    // Only a learner can ask for a drive and be answered from memory.
    let asked = result.remove("asked").unwrap_or(counts.driven.into());
    let vehicle_s = counts.ticks as f64 * config.drive.tick_s;
    let known = json!({
        "schema": 1,
        "kind": kind,
        "maneuver": config.maneuver,
        "seed": config.run.seed,
        "drives": {
            "asked": asked,
            "driven": counts.driven,
            "beside": counts.beside,
            "reissued": counts.reissued,
        },
        "processes": facts.processes.iter().map(|process| json!({
            "name": process.name,
            "pid": process.pid,
            "restarts": process.restarts,
            "dropped": process.refused.dropped,
            "rejected": process.refused.rejected,
            "late": process.refused.late,
        })).collect::<Vec<_>>(),
        "recovery": facts.recovery,
        "tick_ns": facts.tick_ns,
        "waiting": facts.waiting,
        "vehicle_s": vehicle_s,
        "wall_s": facts.wall_s,
        "real_time_factor": vehicle_s / facts.wall_s,
    });
    if let Value::Object(known) = known {
        result.extend(known);
    }
    let result = Value::Object(result);
    let path = folder.join("result.json");
    let part = folder.join("result.json.part");
    fs::write(&part, serde_json::to_vec_pretty(&result)?)
        .and_then(|()| fs::rename(&part, &path))
        .with_context(|| format!("failed to write {path:?}"))?;
    let _ = fs::remove_file(outcome_path);
    Ok(result)
}
