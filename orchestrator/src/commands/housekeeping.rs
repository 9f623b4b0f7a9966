//! Looking after runs from another terminal: `status`, `stop`, `logs`, `clean`, `doctor`.

use std::fs;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context;
use comfy_table::Table;
use comfy_table::presets::NOTHING;
use runtime::run::{RunNames, stale_segments};
use rustix::process::{Resource, getrlimit};
use serde::Serialize;
use serde_json::json;

use crate::pipeline::process::last_lines;
use crate::pipeline::strays::sweep_dead_runs;
use crate::runs::living_run;
use crate::runs::state::{RunState, ShownRun, known_of_car};
use crate::runs::temporary;
use crate::words::Failure;
use crate::words::terminal::say;

/// Lists the living runs, or the one that is named; or prints the configuration for iceoryx2's own command line.
///
/// # Errors
/// If `run` matches no run or several.
pub(crate) fn status(run: Option<&str>, as_json: bool, iox2: bool) -> Result<(), Failure> {
    if iox2 {
        say!("{}", runtime::iox2_config(&living_run(run)?.names)?.trim_end());
        return Ok(());
    }
    let runs = ShownRun::named(run)?;
    if as_json {
        say!("{}", serde_json::to_string(&json!({ "runs": runs })).context("the runs")?);
        return Ok(());
    }
    if runs.is_empty() {
        say!("no run is alive");
    }
    for ShownRun { state, .. } in runs {
        say!(
            "{}  {}  pid {}  batch {} attempt {} tick {}  {}",
            state.run,
            state.maneuver,
            state.pid,
            state.batch,
            state.attempt,
            state.tick,
            state.folder.display()
        );
        if let Some(words) = known_of_car(&state.folder) {
            say!("  {words}");
        }
        let mut table = Table::new();
        table.load_style(NOTHING).set_header([
            "  process",
            "pid",
            "state",
            "restarts",
            "dropped",
            "rejected",
            "late",
        ]);
        for process in state.processes {
            table.add_row([
                format!("  {}", process.facts.name),
                process.facts.pid.to_string(),
                process.state,
                process.facts.restarts.to_string(),
                process.facts.dropped.to_string(),
                process.facts.rejected.to_string(),
                process.facts.late.to_string(),
            ]);
        }
        say!("{table}");
    }
    Ok(())
}

/// Asks a living run to stop, and waits until it has ended.
///
/// # Errors
/// If `run` matches no run or several, or if it does not end.
pub(crate) fn stop(run: Option<&str>) -> Result<(), Failure> {
    let state = RunState::find(run)?;
    if run.is_none() {
        confirm(&state)?;
    }
    state.request_stop().context("failed to ask the run to stop")?;
    // Its processes get five seconds each.
    let until = Instant::now() + Duration::from_secs(30);
    while RunState::living().iter().any(|other| other.run == state.run) {
        if Instant::now() > until {
            return Err(anyhow::anyhow!(
                "run {} does not stop; kill it with: kill -9 {}",
                state.run,
                state.pid
            )
            .into());
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let folder = state.folder.display();
    if state.resumable {
        say!("stopped {}; go on with: pathtune train --resume {folder}", state.run);
    } else {
        say!("stopped {} in {folder}", state.run);
    }
    Ok(())
}

/// Asks before the only run is stopped although nobody named it and it belongs to another folder than this one.
fn confirm(state: &RunState) -> Result<(), Failure> {
    let here = std::env::current_dir().and_then(fs::canonicalize).unwrap_or_default();
    if state.folder.starts_with(&here) {
        return Ok(());
    }
    let question = format!("run {} ({}) in {}", state.run, state.maneuver, state.folder.display());
    if !std::io::stdin().is_terminal() {
        let way_out = format!("name it: pathtune stop {}", &state.run[..state.run.len().min(6)]);
        return Err(Failure::User(format!("{question} is not below this folder; {way_out}")));
    }
    eprint!("{question} is not below this folder. Stop it? [y/N] ");
    let mut answer = String::new();
    std::io::stdin().read_line(&mut answer)?;
    match answer.trim() {
        "y" | "Y" | "yes" => Ok(()),
        _ => Err(Failure::User("nothing was stopped".to_owned())),
    }
}

/// Prints the last lines of a run's logs; the run is a living one or an output folder.
///
/// # Errors
/// If `run` matches no run, or it has no such log.
pub(crate) fn logs(run: Option<&str>, process: Option<&str>, lines: usize) -> Result<(), Failure> {
    let folder = match run.map(Path::new).filter(|path| path.join("logs").is_dir()) {
        Some(folder) => folder.to_owned(),
        None => RunState::find(run)?.folder,
    };
    let mut paths: Vec<PathBuf> = fs::read_dir(folder.join("logs"))
        .with_context(|| format!("failed to read {:?}", folder.join("logs")))?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|it| it == "log"))
        .filter(|path| process.is_none_or(|name| path.file_stem().is_some_and(|stem| stem == name)))
        .collect();
    paths.sort();
    if paths.is_empty() {
        return Err(Failure::User(format!(
            "{} has no log of {}",
            folder.display(),
            process.unwrap_or("any process")
        )));
    }
    for path in paths {
        say!("==> {} <==", path.display());
        for line in last_lines(&path, lines) {
            say!("{line}");
        }
    }
    Ok(())
}

/// Removes what dead runs left, or says what would be removed.
///
/// # Errors
/// None that a user could do anything about.
pub(crate) fn clean(dry_run: bool) -> Result<(), Failure> {
    let stale = stale_segments();
    if dry_run {
        for run in runtime::run::dead_runs() {
            say!("would remove {} and its segments", run.root.display());
        }
        for name in &stale {
            say!("would remove /dev/shm/{name}");
        }
        for folder in temporary::left_behind() {
            say!("would remove {}", folder.display());
        }
        return Ok(());
    }
    let swept = sweep_dead_runs();
    for name in &stale {
        let _ = fs::remove_file(Path::new("/dev/shm").join(name));
    }
    let folders = temporary::sweep();
    say!(
        "removed {} dead runs, {} stray segments and {folders} folders of killed replays",
        swept.len(),
        stale.len()
    );
    Ok(())
}

/// One finding of the doctor.
#[derive(Debug, Serialize)]
struct Finding {
    check: &'static str,
    ok: bool,
    found: String,
    /// What to do if something is wrong.
    advice: &'static str,
}

/// Checks whether the machine has what a run needs, and says what to do if not.
///
/// # Errors
/// If something would prevent a run from working; exit code 1.
pub(crate) fn doctor(as_json: bool) -> Result<(), Failure> {
    let findings = examine();
    if as_json {
        say!("{}", json!({ "checks": findings }));
    } else {
        for finding in &findings {
            let mark = if finding.ok { "ok  " } else { "look" };
            say!("{mark}  {}: {}", finding.check, finding.found);
            if !finding.ok {
                say!("      {}", finding.advice);
            }
        }
    }
    // Only the first findings prevent a run from working; the others are advice.
    match findings.iter().take(2).find(|finding| !finding.ok) {
        None => Ok(()),
        Some(finding) => Err(anyhow::anyhow!("{}: {}", finding.check, finding.found).into()),
    }
}

fn examine() -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut add = |check, ok, found: String, advice| {
        findings.push(Finding { check, ok, found, advice });
    };
    let free = rustix::fs::statvfs("/dev/shm").map(|stat| stat.f_bavail * stat.f_frsize);
    let free_mib = free.map_or(0, |bytes| bytes >> 20);
    add(
        "shared memory",
        free_mib >= 32,
        format!("{free_mib} MiB free in /dev/shm"),
        "free some of it, or enlarge it: mount -o remount,size=256m /dev/shm (docker: --shm-size)",
    );
    let folder = RunNames::create().map(|names| {
        let root = names.root.clone();
        names.remove();
        root
    });
    add(
        "run folder",
        folder.is_ok(),
        match &folder {
            Ok(root) => {
                let private = format!("{} is private", root.parent().unwrap_or(root).display());
                runtime::run::passed_over()
                    .map_or(private.clone(), |why| format!("{private} ({why})"))
            }
            Err(error) => error.to_string(),
        },
        "set XDG_RUNTIME_DIR to a folder of your own with a short path",
    );
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    add(
        "cores",
        cores >= 2,
        format!("{cores}, one for each pipeline"),
        "with a single core, the orchestrator and the trainer share it with the ring: slower, but otherwise the same",
    );
    let files = getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX);
    add(
        "open files",
        files >= 1024,
        format!("{files} for each process"),
        "raise it: ulimit -n 1024",
    );
    let priority = getrlimit(Resource::Rtprio).current.unwrap_or(u64::MAX);
    add(
        "real-time priority",
        priority > 0 || rustix::process::geteuid().is_root(),
        format!("up to {priority} without privileges"),
        "needed only for driving in real time: grant rtprio in /etc/security/limits.conf",
    );
    let locked = getrlimit(Resource::Memlock).current.map_or(u64::MAX, |bytes| bytes >> 20);
    add(
        "locked memory",
        locked >= 64,
        format!(
            "{} MiB",
            if locked == u64::MAX { "any number of".to_owned() } else { locked.to_string() }
        ),
        "needed only for driving in real time: grant memlock in /etc/security/limits.conf",
    );
    let (dead, stray) = (runtime::run::dead_runs().len(), stale_segments().len());
    add(
        "leftovers",
        dead + stray == 0,
        format!("{dead} dead runs, {stray} stray segments"),
        "remove them with: pathtune clean (the next run does so, too)",
    );
    findings
}
