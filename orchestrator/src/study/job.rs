//! One job: a whole training, or the validation of a set, in this process; and its record.
//!
//! A job that was killed leaves its run's folder in the scratch folder. Where the next trial finds it, it goes on from its
//! journal; elsewhere it begins anew. Both come to the same bytes.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use config::open_regular;
use outcome::{OUTCOME_FILE, RunResult, read_result};
use rustix::process::{Signal, getppid, set_parent_process_death_signal};
use rustix::thread::{CpuSet, sched_setaffinity};

use crate::cli::{RunJobsArgs, TrainArgs, ValidateArgs};
use crate::commands::{train_silently, validate_silently};
use crate::pipeline::services::Services;
use crate::runs::preflight::check_resources;
use crate::study::StudyTools;
use crate::study::axes::compared_over;
use crate::study::identity::{Family, JobOptions, options_of, resolve};
use crate::study::manifest::{Job, Manifest};
use crate::study::record::Record;
use crate::study::store::{Store, host};
use crate::words::Failure;
use crate::words::terminal::tell;

/// Runs the job with an index, unless it is done already.
///
/// # Errors
/// [`Failure::User`] if trying again is useless, otherwise [`Failure::TryAgain`].
pub(crate) fn run_job(
    args: &RunJobsArgs,
    index: u64,
    services: Services,
    tools: StudyTools,
) -> Result<(), Failure> {
    tie_to(args)?;
    let job = Manifest::open(&args.at.manifest)?.job(index)?;
    let store = Store::of(&args.at).make()?;
    if store.is_done(&job.job) {
        say(args, &format!("job {index} is done already"));
        return Ok(());
    }
    match try_job(args, &job, &store, services, tools) {
        Ok(()) => {
            say(args, &format!("job {index} is done"));
            Ok(())
        }
        // Another engine on the same manifest and scratch folder was faster, and took away what this one stood on.
        Err(_) if store.is_done(&job.job) => {
            say(args, &format!("job {index} is done: another process ran it at the same time"));
            Ok(())
        }
        Err(failure) => {
            let failure = match failure {
                Failure::User(_) | Failure::TryAgain(_) => failure,
                Failure::Interrupted(..) => {
                    // It did not fail: nothing is noted.
                    let way_on = "interrupted; the same command goes on with it";
                    return Err(Failure::TryAgain(format!("job {index}: {way_on}")));
                }
                other => Failure::TryAgain(other.message()),
            };
            if let Err(why) = store.note_failure(&job.job, failure.code(), &failure.message()) {
                tell!("pathtune: {why}");
            }
            Err(failure.with(|why| format!("job {index}: {why}")))
        }
    }
}

fn say(args: &RunJobsArgs, line: &str) {
    if !args.quiet {
        tell!("pathtune: {line}");
    }
}

/// Takes the core that this process was given, and ties it to the process that started it as one of several.
fn tie_to(args: &RunJobsArgs) -> Result<(), Failure> {
    if let Some(parent) = args.under {
        set_parent_process_death_signal(Some(Signal::TERM)).map_err(io::Error::from)?;
        // It may have died before the signal was asked for.
        if getppid().map(|pid| pid.as_raw_nonzero().get()) != Some(parent) {
            return Err(Failure::TryAgain("the process that started this one is gone".to_owned()));
        }
    }
    if let Some(core) = args.core {
        let wrong = |why: &str| Failure::User(format!("--core {core}: {why}"));
        if core >= CpuSet::MAX_CPU {
            return Err(wrong("there is no such core"));
        }
        let mut cores = CpuSet::new();
        cores.set(core);
        sched_setaffinity(None, &cores).map_err(|_| wrong("this machine does not give it"))?;
    }
    Ok(())
}

fn try_job(
    args: &RunJobsArgs,
    job: &Job,
    store: &Store,
    services: Services,
    tools: StudyTools,
) -> Result<(), Failure> {
    // Files that the command names are relative to the manifest.
    let scratch = absolute(&args.scratch.clone().unwrap_or_else(|| store.folder.join("work")))?;
    let home = fs::canonicalize(&args.at.manifest)?;
    std::env::set_current_dir(home.parent().unwrap_or(Path::new("/")))?;
    let options = options_of(&job.command)?;
    let resolved = resolve(&job.command)?;
    let compared = compared_over(&job.axes);
    let config = &resolved.config;
    if Family::of(&resolved).compared(compared).identity(config.run.seed) != job.job {
        let why = "planned with another configuration, other files or another version of pathtune";
        return Err(Failure::User(format!("{why}; plan the study again")));
    }
    let folder = scratch.join(&job.job);
    // Before what an earlier trial left: this says nothing about it.
    check_resources(resolved.max_len()).map_err(|failure| Failure::TryAgain(failure.message()))?;
    let trial = match options {
        JobOptions::Train(options) => train_in(&folder, options, args, services),
        JobOptions::Validate(options) => validate_in(&folder, options, services),
    };
    let result = trial.map_err(|failure| match failure {
        // The configuration is right: what is left is this machine.
        Failure::User(why) => Failure::TryAgain(why),
        other => other,
    })?;
    let failed = |why: String| Failure::TryAgain(why);
    let outcome = fs::read(folder.join(OUTCOME_FILE)).map_err(|error| {
        let why = format!("{}: {error}; another process may run this job, too", folder.display());
        Failure::TryAgain(why)
    })?;
    let course = compared.map(|drives| (tools.course)(config, drives));
    let course = course.transpose().map_err(|why| Failure::User(format!("compare: {why}")))?;
    let record = Record::of(&job.job, &result, &outcome, course, &host()).map_err(failed)?;
    store.keep(&record, &outcome).map_err(failed)?;
    if !args.keep {
        // What cannot be removed is in nobody's way.
        let _ = fs::remove_dir_all(&folder);
    }
    Ok(())
}

/// Trains in a folder, or goes on with the training that an earlier trial left there.
fn train_in(
    folder: &Path,
    mut options: Box<TrainArgs>,
    args: &RunJobsArgs,
    services: Services,
) -> Result<RunResult, Failure> {
    prepare(folder, &mut options)?;
    if let Some(result) = finished(folder) {
        return Ok(result);
    }
    match train_silently(&options, services) {
        // What an earlier trial left is of no use, as after a power cut: from the beginning, then.
        Err(Failure::User(why)) if options.resume.is_some() => {
            say(args, &format!("begins anew: {why}"));
            wait_for_lock(folder)?;
            remove(folder)?;
            options.resume = None;
            options.setup.out = Some(folder.to_owned());
            train_silently(&options, services)
        }
        other => other,
    }
}

/// Validates in a folder, from the beginning: it takes a second.
fn validate_in(
    folder: &Path,
    mut options: Box<ValidateArgs>,
    services: Services,
) -> Result<RunResult, Failure> {
    if folder.exists() {
        wait_for_lock(folder)?;
        if let Some(result) = finished(folder) {
            return Ok(result);
        }
        remove(folder)?;
    }
    options.setup.quiet = true;
    options.setup.out = Some(folder.to_owned());
    validate_silently(&options, services)
}

/// A folder's whole path, made if it is not there.
fn absolute(folder: &Path) -> Result<PathBuf, Failure> {
    let fail = |error: io::Error| {
        Failure::TryAgain(format!("{}: cannot be made: {error}", folder.display()))
    };
    fs::create_dir_all(folder).map_err(fail)?;
    fs::canonicalize(folder).map_err(fail)
}

/// Sets the options such that the training goes on from what an earlier trial left, or begins anew.
fn prepare(folder: &Path, options: &mut TrainArgs) -> Result<(), Failure> {
    options.setup.quiet = true;
    if !folder.exists() {
        options.setup.out = Some(folder.to_owned());
        return Ok(());
    }
    wait_for_lock(folder)?;
    // Both are written before the first drive.
    if ["config.toml", "launch.toml", "journal"].iter().all(|name| folder.join(name).exists()) {
        options.resume = Some(folder.to_owned());
    } else {
        remove(folder)?;
        options.setup.out = Some(folder.to_owned());
    }
    Ok(())
}

/// Removes what an earlier trial left, unless another process has just done so.
fn remove(folder: &Path) -> Result<(), Failure> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            let why = format!("{}: cannot be removed: {error}", folder.display());
            Err(Failure::TryAgain(why))
        }
        _ => Ok(()),
    }
}

/// Refuses a folder in which another process trains. Those of a killed trial may need a moment to follow it.
fn wait_for_lock(folder: &Path) -> Result<(), Failure> {
    let until = Instant::now() + Duration::from_secs(2);
    while let Ok(lock) = open_regular(&folder.join("lock"))
        && lock.try_lock_shared().is_err()
    {
        if Instant::now() > until {
            let why = format!("another process runs it in {}", folder.display());
            return Err(Failure::TryAgain(why));
        }
        thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}

/// The result of a trial that came to its end, and was killed before its record was written.
fn finished(folder: &Path) -> Option<RunResult> {
    let result = read_result(folder).ok()?;
    folder.join(OUTCOME_FILE).exists().then_some(result)
}
