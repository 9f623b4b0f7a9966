//! `result.json`, and the table at the end of a training.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, Table};
use config::RunConfig;
use serde_json::{Value, json};

use crate::Failure;
use crate::sequencer::Counts;
use crate::terminal::say;

/// What only the orchestrator knows of a run.
pub(crate) struct RunFacts {
    pub(crate) counts: Counts,
    pub(crate) processes: Vec<ProcessFacts>,
    /// Faults and recoveries.
    pub(crate) recovery: Value,
    pub(crate) wall_s: f64,
    /// Mean time of a tick, from the request of a batch to its report.
    pub(crate) tick_ns: f64,
}

/// One process.
pub(crate) struct ProcessFacts {
    pub(crate) name: &'static str,
    pub(crate) pid: u32,
    pub(crate) restarts: u32,
    /// Samples that did not belong, and samples that were no numbers.
    pub(crate) dropped: u64,
    pub(crate) rejected: u64,
}

/// Joins the trainer's outcome with what only the orchestrator knows, and writes `result.json`.
pub(crate) fn write_result(folder: &Path, config: &RunConfig, facts: &RunFacts) -> Result<Value> {
    let outcome_path = folder.join("outcome.json");
    let text =
        fs::read(&outcome_path).with_context(|| format!("failed to read {outcome_path:?}"))?;
    let mut outcome: Value = serde_json::from_slice(&text)
        .with_context(|| format!("failed to parse {outcome_path:?}"))?;
    let mut take = |key: &str| outcome.get_mut(key).map(Value::take).unwrap_or_default();
    let vehicle_s = facts.counts.ticks as f64 * config.drive.tick_s;
    let result = json!({
        "schema": 1,
        "maneuver": config.maneuver,
        "seed": config.run.seed,
        "digest": take("digest"),
        "gains": take("gains"),
        "on_bound": take("on_bound"),
        "distance": take("distance"),
        "mse_m2": take("mse_m2"),
        "grid": take("grid"),
        "paper": take("paper"),
        "plain_q": take("plain_q"),
        "drives": {
            "asked": take("asked"),
            "driven": facts.counts.driven,
            "reissued": facts.counts.reissued,
        },
        "learners": take("learners"),
        "processes": facts.processes.iter().map(|process| json!({
            "name": process.name,
            "pid": process.pid,
            "restarts": process.restarts,
            "dropped": process.dropped,
            "rejected": process.rejected,
        })).collect::<Vec<_>>(),
        "recovery": facts.recovery,
        "tick_ns": facts.tick_ns,
        "vehicle_s": vehicle_s,
        "wall_s": facts.wall_s,
        "real_time_factor": vehicle_s / facts.wall_s,
    });
    let path = folder.join("result.json");
    let part = folder.join("result.json.part");
    fs::write(&part, serde_json::to_vec_pretty(&result)?)
        .and_then(|()| fs::rename(&part, &path))
        .with_context(|| format!("failed to write {path:?}"))?;
    let _ = fs::remove_file(outcome_path);
    Ok(result)
}

/// The table at the end of a training.
pub(crate) fn print_table(
    config: &RunConfig,
    result: &Value,
    folder: &Path,
) -> Result<(), Failure> {
    let size = result["grid"]["size"].as_u64().unwrap_or_default();
    let mut table = Table::new();
    table
        .load_style(NOTHING)
        .set_header(["", "Kv", "Kl", "Ks", "Ki", "distance", "rank", "mse m²", "rank"]);
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    let mut row = |name: &str, set: &Value, ranks: &Value| {
        let gain = |key: &str| trim(set["gains"][key].as_f64().unwrap_or(f64::NAN));
        let number = |key: &str| format!("{:.4}", set[key].as_f64().unwrap_or(f64::NAN));
        let rank = |key: &str| format!("{}/{size}", ranks[key].as_u64().unwrap_or_default());
        table.add_row([
            name.to_owned(),
            gain("kv"),
            gain("kl"),
            gain("ks"),
            gain("ki"),
            number("distance"),
            rank("rank_distance"),
            number("mse_m2"),
            rank("rank_mse"),
        ]);
    };
    let tuner = match config.learning.tuner {
        config::Tuner::EducatedQ => "tuned (educated Q)",
        config::Tuner::Q => "tuned (Q)",
    };
    row(tuner, result, &result["grid"]);
    row("plain Q beside it", &result["plain_q"], &result["plain_q"]);
    row("the paper's set", &result["paper"], &result["paper"]);
    say!("{table}");

    let text = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let grid = &result["grid"];
    say!(
        "ranks among all {size} sets of the grid, noise-free; its best: distance {:.4}, mse {:.4} m²",
        text(&grid["best_distance"]),
        text(&grid["best_mse_m2"]),
    );
    let bounds: Vec<&str> =
        result["on_bound"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    if !bounds.is_empty() {
        say!("on a bound of the grid: {}; better gains may lie beyond it", bounds.join(", "),);
    }
    let drives = &result["drives"];
    say!(
        "{} drives asked for ({} by plain Q), {} driven, {} again behind a crash; the grid holds {size}",
        drives["asked"],
        result["plain_q"]["asked"],
        drives["driven"],
        drives["reissued"],
    );
    let recovery = &result["recovery"];
    if recovery["recoveries"].as_u64().unwrap_or_default() > 0 {
        let time = &recovery["death_to_tick_ms"];
        say!(
            "{} faults injected, {} recoveries; from death to the next tick p50 {:.0} ms, p99 {:.0} ms, max {:.0} ms",
            recovery["injected"],
            recovery["recoveries"],
            text(&time["p50"]),
            text(&time["p99"]),
            text(&time["max"]),
        );
    }
    say!(
        "{:.0} s of driving in {:.1} s: {:.0} x real time",
        text(&result["vehicle_s"]),
        text(&result["wall_s"]),
        text(&result["real_time_factor"]),
    );
    say!("digest {}", result["digest"].as_str().unwrap_or_default());
    let path = folder.join("result.json");
    let here = std::env::current_dir().unwrap_or_default();
    say!("{}", path.strip_prefix(here).unwrap_or(&path).display());
    Ok(())
}

/// A gain with as many digits as it needs.
fn trim(gain: f64) -> String {
    let text = format!("{gain:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
