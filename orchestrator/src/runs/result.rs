//! `result.json`: what the process in the trainer's role has found out, joined with what only the orchestrator knows.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use config::RunConfig;
use ipc_types::Safety;
use outcome::{
    Drives, OUTCOME_FILE, Outcome, RESULT_FILE, Run, RunDrives, RunResult, SingleDrive,
    read_decided, to_json,
};

use crate::pipeline::main_loop::describe_reasons;
use crate::pipeline::plan::{PipelineFacts, Plan};
use crate::runs::running::RunFacts;
use crate::words::tables::{how_stopped, in_words, trim};
use crate::words::terminal::{say, tell};
use crate::words::{Failure, tables};

/// A run that has ended.
#[derive(Debug)]
pub struct EndedRun {
    /// Its folder.
    pub folder: PathBuf,
    /// Standard output is reserved for its JSON.
    pub json: bool,
    /// The signal that has stopped it before its end, and what was driven by then.
    pub stopped: Option<(i32, String)>,
    /// Why a single drive did not arrive.
    pub not_arrived: Option<String>,
}

/// Writes `result.json`, and prints it or its table. Of a run that was stopped, both hold what was driven by then.
pub(crate) fn conclude(plan: &Plan, facts: &RunFacts, json: bool) -> Result<EndedRun, Failure> {
    let PipelineFacts { stopped_by, out_of_patience, .. } = facts.pipeline;
    if !plan.folder.join(OUTCOME_FILE).exists() {
        if let Some(signal) = stopped_by {
            let left = "the processes were stopped before anything was driven".to_owned();
            return Err(Failure::Interrupted(signal, left));
        }
        if let Some(reasons) = out_of_patience {
            let why = match reasons {
                0 => "it has not begun".to_owned(),
                _ => format!("the gate stopped the vehicle: {}", describe_reasons(reasons)),
            };
            return Err(Failure::NotArrived(why + &waited(reasons, &plan.config)));
        }
    }
    let result = write_result(plan, facts)?;
    if json {
        // Byte for byte the content of the file.
        let bytes = to_json(&result);
        say!("{}", String::from_utf8_lossy(&bytes).trim_end());
    } else {
        tables::print_result(&result, &plan.config)?;
    }
    tell_losses(&result, plan.launch.is_recorded());
    let stopped = stopped_by.zip(result.run.stopped_after);
    let not_arrived = match &result.decided.outcome {
        Outcome::Drive(drive) => why_not_arrived(drive, &plan.config),
        _ => None,
    };
    let waited = out_of_patience.map_or(String::new(), |reasons| waited(reasons, &plan.config));
    let not_arrived = not_arrived.map(|why| why + &waited);
    Ok(EndedRun { folder: plan.folder.clone(), json, stopped, not_arrived })
}

/// For what a stopped vehicle has waited in vain.
fn waited(reasons: u32, config: &RunConfig) -> String {
    let what = match reasons {
        0 => "the vehicle sent no odometry",
        _ if reasons & Safety::OF_THE_DRIVE != 0 => return String::new(),
        _ => "nobody rearmed it",
    };
    format!("; {what} within {} s (drive.patience_s)", config.drive.patience_s)
}

/// Why a drive did not arrive; `None` if it did, or if it was to end by its time and did.
fn why_not_arrived(drive: &SingleDrive, config: &RunConfig) -> Option<String> {
    let place = format!("at {:.0} % of the path", 100.0 * drive.progress);
    match &*drive.reason {
        "goal" => None,
        "time" if !config.is_to_arrive() => None,
        // It has passed the end, and was not near enough.
        "time" if drive.progress >= 1.0 => Some(format!(
            "it passed the end of the path more than {} m beside it (drive.goal_radius_m)",
            trim(config.drive.goal_radius_m)
        )),
        "time" => Some(format!("its time was over {place} (drive.loop_time_s)")),
        "collision" => Some(format!("a collision {place}")),
        "held" => Some(format!("the vehicle did not follow, {place} (reference.wait_limit_s)")),
        _ => Some(format!(
            "the gate stopped the vehicle {place}{}: {}",
            how_stopped(drive),
            in_words(&drive.stopped_for)
        )),
    }
}

/// Says what recordings lack: nobody looks for that in a log.
fn tell_losses(result: &RunResult, is_recorded: bool) {
    match &result.run.recording {
        Some(recording) => recording.told().iter().for_each(|line| tell!("pathtune: {line}")),
        None if is_recorded => {
            tell!("pathtune: the recorder was killed: the recording lacks its end")
        }
        None => {}
    }
    for (name, ticks) in result.decided.outcome.drives_lacking() {
        tell!(
            "pathtune: drives/{name}.csv lacks {ticks} ticks: not every process sent a message of them"
        );
    }
}

/// Joins the outcome with what only the orchestrator knows, and writes `result.json`, by rename, so that nobody reads
/// half of it.
pub(crate) fn write_result(plan: &Plan, facts: &RunFacts) -> Result<RunResult, Failure> {
    let Plan { folder, config, .. } = plan;
    let mut decided = read_decided(folder).map_err(anyhow::Error::from)?;
    if let (Some(reasons @ 1..), Outcome::Drive(drive)) =
        (facts.pipeline.out_of_patience, &mut decided.outcome)
    {
        // What recorded it knows no more than that it was interrupted.
        drive.reason = "stopped".to_owned();
        drive.stopped_for = Safety::reason_names(reasons).into_iter().map(str::to_owned).collect();
        drive.stopped_how = Some(Safety::action_name(reasons).to_owned());
    }
    let stopped_after = facts.pipeline.stopped_by.map(|_| driven_so_far(&decided.outcome, plan));
    let run = Run { stopped_after, ..of_run(config, facts) };
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

/// What was driven of a run that was stopped before its end.
fn driven_so_far(outcome: &Outcome, plan: &Plan) -> String {
    let sets = |driven: usize, of: usize| format!("{driven} of {of} sets");
    match outcome {
        Outcome::Train(it) => format!("{} drives", it.asked),
        Outcome::Validate(it) => {
            let named = plan.sweep.as_ref().map_or(0, |sweep| sweep.sets.len());
            let all = if named == 0 { plan.config.paper_rows().len() } else { named };
            sets(it.rows.len(), all)
        }
        Outcome::Grid(it) => sets(it.size, plan.config.grid().len()),
        Outcome::Drive(it) => format!("{:.1} s", it.driven_s),
    }
}

/// The drives that a run comes to, whichever process had to make them again.
fn drives_of(outcome: &Outcome, config: &RunConfig) -> Drives {
    let all = |count: u64| Drives { asked: count, driven: count, for_table: 0 };
    match outcome {
        Outcome::Train(it) => Drives {
            asked: it.asked,
            driven: if config.run.memo { it.distinct } else { it.asked },
            for_table: it.vehicle_drives.map_or(0, |it| it.for_table),
        },
        Outcome::Validate(it) => all(it.rows.len() as u64 * (1 + it.repeats)),
        Outcome::Grid(it) => all((it.size + it.sets.len()) as u64),
        Outcome::Drive(_) => all(1),
    }
}

fn of_run(config: &RunConfig, facts: &RunFacts) -> Run {
    let RunFacts { started_at, ended_at, pipeline } = facts;
    let PipelineFacts {
        counts,
        processes,
        recovery,
        wall_s,
        tick_ns,
        recording,
        waiting,
        rings,
        stopped_by: _,
        out_of_patience: _,
    } = pipeline;
    let vehicle_s = counts.ticks as f64 * config.drive.tick_s;
    let time = |at: &jiff::Timestamp| at.strftime("%Y-%m-%dT%H:%M:%S.%3fZ").to_string();
    Run {
        stopped_after: None,
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
        recording: recording.clone(),
        recovery: *recovery,
        tick_ns: *tick_ns,
        waiting: (*waiting).to_owned(),
        rings: *rings,
    }
}

/// Names the files of an ended run that people will want to open.
///
/// # Errors
/// If the run was stopped before its end.
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
    if let Some((signal, after)) = &ended.stopped {
        let left = format!("stopped after {after}, which is kept in {}", near(&ended.folder));
        return Err(Failure::Interrupted(*signal, left));
    }
    match &ended.not_arrived {
        None => Ok(()),
        Some(why) => Err(Failure::NotArrived(why.clone())),
    }
}
