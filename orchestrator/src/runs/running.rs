//! Runs a planned pipeline to its end.

use std::fs::File;
use std::path::Path;
use std::sync::Mutex;

use anyhow::Context;
use config::SweepPlan;
use jiff::Timestamp;
use runtime::log_file::LogFile;
use runtime::run::RunNames;

use crate::pipeline::main_loop::{Pipeline, log_of_orchestrator};
use crate::pipeline::plan::{PipelineFacts, Plan};
use crate::pipeline::progress::Progress;
use crate::runs::files::write_whole;
use crate::runs::preflight;
use crate::runs::setup::Ready;
use crate::words::Failure;
use crate::words::terminal::tell;

/// What only the orchestrator knows about a run.
pub(crate) struct RunFacts {
    pub(crate) started_at: Timestamp,
    pub(crate) ended_at: Timestamp,
    pub(crate) pipeline: PipelineFacts,
}

/// Runs a plan. If that fails because of a user's mistake, a folder that is `new` is removed again.
pub(crate) fn run_or_unmake(ready: &Ready, new: bool) -> Result<RunFacts, Failure> {
    run(&ready.plan).inspect_err(|failure| {
        if new && matches!(failure, Failure::User(_)) {
            preflight::unmake_folder(&ready.plan.folder);
        }
    })
}

/// Runs the pipeline. Whatever happens, nothing of it remains in shared memory.
pub(crate) fn run(plan: &Plan) -> Result<RunFacts, Failure> {
    let started_at = Timestamp::now();
    let names = PrivateNames::create()?;
    let folder = &plan.folder;
    let text = toml::to_string(&plan.config).context("the configuration")?;
    write(&folder.join("config.toml"), &text)?;
    let text = toml::to_string(&plan.launch).context("the launch file")?;
    write(&folder.join("launch.toml"), &text)?;
    if let Some(sweep) = &plan.sweep {
        let text = toml::to_string(sweep).context("the list of drives")?;
        write(&folder.join(SweepPlan::FILE), &text)?;
    }
    log_to(&log_of_orchestrator(folder))?;

    let span = tracing::info_span!("run", run = format!("{:016x}", names.names.run));
    let pipeline = span.in_scope(|| {
        let objective = &plan.config.objective.name;
        let mut progress = Progress::new(plan.quiet, plan.config.drive.tick_s, objective);
        let result = Pipeline::new(plan, &names.names, &mut progress)
            .and_then(|mut pipeline| pipeline.run_to_end());
        progress.finish();
        result
    })?;
    Ok(RunFacts { started_at, ended_at: Timestamp::now(), pipeline })
}

/// The names of a run on this machine. When this is dropped, everything below them is removed.
pub(crate) struct PrivateNames {
    pub(crate) names: RunNames,
    /// Held until the end: while it is held, nobody removes this run as dead.
    _lock: File,
}

impl PrivateNames {
    /// Makes new ones.
    pub(crate) fn create() -> Result<Self, Failure> {
        if let Some(why) = runtime::run::passed_over() {
            tell!("pathtune: {why}");
        }
        let (names, lock) = RunNames::start().map_err(|error| Failure::User(error.to_string()))?;
        Ok(Self { names, _lock: lock })
    }
}

impl Drop for PrivateNames {
    fn drop(&mut self) {
        self.names.remove();
    }
}

fn write(path: &Path, text: &str) -> Result<(), Failure> {
    write_whole(path, text).with_context(|| format!("failed to write {path:?}"))?;
    Ok(())
}

/// The orchestrator's own log goes to a file: the terminal belongs to the user.
fn log_to(path: &Path) -> Result<(), Failure> {
    let log = LogFile::open(path).with_context(|| format!("failed to write {path:?}"))?;
    runtime::logging::init_to(Mutex::new(log));
    Ok(())
}
