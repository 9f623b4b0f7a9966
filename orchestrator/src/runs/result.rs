//! `result.json`: what the process in the trainer's role has found out, joined with what only the orchestrator knows.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use config::RunConfig;
use outcome::{Drives, Outcome, RESULT_FILE, Run, RunDrives, RunResult, read_decided, to_json};

use crate::pipeline::plan::{PipelineFacts, Plan};
use crate::runs::running::RunFacts;
use crate::words::terminal::{say, tell};
use crate::words::{Failure, tables};

/// A run that has ended.
#[derive(Debug)]
pub struct EndedRun {
    /// Its folder.
    pub folder: PathBuf,
    /// Standard output is reserved for its JSON.
    pub json: bool,
}

/// Writes `result.json`, and prints it or its table.
pub(crate) fn conclude(plan: &Plan, facts: &RunFacts, json: bool) -> Result<EndedRun, Failure> {
    let result = write_result(&plan.folder, &plan.config, facts)?;
    if json {
        // Byte for byte the content of the file.
        let bytes = to_json(&result);
        say!("{}", String::from_utf8_lossy(&bytes).trim_end());
    } else {
        tables::print_result(&result, &plan.config)?;
    }
    Ok(EndedRun { folder: plan.folder.clone(), json })
}

/// Joins the outcome with what only the orchestrator knows, and writes `result.json`, by rename, so that nobody reads
/// half of it.
fn write_result(folder: &Path, config: &RunConfig, facts: &RunFacts) -> Result<RunResult, Failure> {
    let decided = read_decided(folder).map_err(anyhow::Error::from)?;
    let run = of_run(config, facts)?;
    let result = RunResult {
        drives: drives_of(&decided.outcome, config),
        processes: run.processes.clone(),
        real_time_factor: run.real_time_factor,
        decided,
        run,
    };
    let path = folder.join(RESULT_FILE);
    let part = path.with_extension("json.part");
    fs::write(&part, to_json(&result))
        .and_then(|()| fs::rename(&part, &path))
        .with_context(|| format!("failed to write {path:?}"))?;
    Ok(result)
}

/// The drives that a run comes to, whichever process had to make them again.
fn drives_of(outcome: &Outcome, config: &RunConfig) -> Drives {
    let all = |count: u64| Drives { asked: count, driven: count };
    match outcome {
        Outcome::Train(it) if config.run.memo => Drives { asked: it.asked, driven: it.distinct },
        Outcome::Train(it) => all(it.asked),
        Outcome::Validate(it) => all(it.rows.len() as u64 * (1 + it.repeats)),
        Outcome::Grid(it) => all((it.size + it.sets.len()) as u64),
        Outcome::Drive(_) => all(1),
    }
}

fn of_run(config: &RunConfig, facts: &RunFacts) -> Result<Run, Failure> {
    let RunFacts { started_at, ended_at, pipeline } = facts;
    let PipelineFacts { counts, processes, recovery, wall_s, tick_ns, waiting } = pipeline;
    let vehicle_s = counts.ticks as f64 * config.drive.tick_s;
    let time = |at: &jiff::Timestamp| at.strftime("%Y-%m-%dT%H:%M:%S.%3fZ").to_string();
    Ok(Run {
        pathtune: env!("CARGO_PKG_VERSION").to_owned(),
        command: std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect(),
        started_at: time(started_at),
        ended_at: time(ended_at),
        wall_s: *wall_s,
        vehicle_s,
        real_time_factor: vehicle_s / wall_s,
        drives: RunDrives {
            reported: counts.reported,
            beside: counts.beside,
            reissued: counts.reissued,
        },
        processes: processes.clone(),
        recovery: serde_json::to_value(recovery).context("the recoveries")?,
        tick_ns: *tick_ns,
        waiting: (*waiting).to_owned(),
    })
}

/// Names the files of an ended run that people will want to open.
pub(crate) fn name_files(ended: &EndedRun, report: Result<PathBuf, String>) -> Result<(), Failure> {
    let here = std::env::current_dir().unwrap_or_default();
    let near = |path: &Path| path.strip_prefix(&here).unwrap_or(path).display().to_string();
    match (report, ended.json) {
        // The result is valid even if its pictures cannot be drawn.
        (Err(why), _) => tell!("pathtune: no report: {why}"),
        (Ok(_), true) => {}
        (Ok(report), false) => {
            say!("{}", near(&ended.folder.join(RESULT_FILE)));
            say!("{}", near(&report));
        }
    }
    Ok(())
}
