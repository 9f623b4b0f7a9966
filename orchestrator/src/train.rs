//! `pathtune train`: from options to a result.

use std::fs::{self, File, OpenOptions};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Duration;

use anyhow::Context;
use config::launch::Launch;
use config::{Layers, RunConfig};
use runtime::chaos::Script;
use runtime::run::{LOCK_FILE, RunNames, sweep_dead_runs};

use crate::cli::{TrainArgs, TunerArg};
use crate::pipeline::{Interrupts, Pipeline, Plan, log_of_orchestrator};
use crate::progress::Progress;
use crate::report::{RunFacts, print_table, write_result};
use crate::restart::Budget;
use crate::terminal::say;
use crate::{Failure, preflight};

/// Trains a manoeuvre to its end, or goes on with a training that was interrupted.
///
/// # Errors
/// The user's mistakes, before anything was started; a pipeline that could not be kept alive.
pub fn train(args: &TrainArgs) -> Result<(), Failure> {
    // First of all: from here on a signal ends in order.
    let interrupted = Interrupts::new()?;
    if let Some(script) = &args.chaos {
        Script::parse(script).map_err(|why| Failure::User(format!("--chaos: {why}")))?;
    }
    let (config, launch) = match &args.resume {
        Some(folder) => resolved_before(folder)?,
        None => {
            let launch = resolve_launch(args)?;
            (resolve_config(args, &launch)?, launch)
        }
    };
    preflight::check_commands(&launch)?;
    sweep_dead_runs();
    preflight::check_shared_memory(config.fleet().max(config.run.alphas.len()))?;
    let folder = match &args.resume {
        Some(folder) => fs::canonicalize(folder)?,
        None => preflight::make_folder(&folder_of(args, &config))?,
    };
    // Held until the end: as long as it is, nobody else trains in this folder.
    let _lock = preflight::lock_folder(&folder)?;
    let plan = Plan {
        config,
        launch,
        folder,
        budget: Budget { restarts: args.restart_budget, within: Duration::from_secs(10) },
        chaos: args.chaos.clone().map(|script| (script, args.chaos_seed)),
        quiet: args.quiet || args.json,
        interrupted,
    };

    let facts = match run(&plan) {
        Ok(facts) => facts,
        Err(failure) => {
            if matches!(failure, Failure::User(_)) && args.resume.is_none() {
                preflight::unmake_folder(&plan.folder);
            }
            return Err(failure);
        }
    };
    let result = write_result(&plan.folder, &plan.config, &facts)?;
    if args.json {
        say!("{}", serde_json::to_string_pretty(&result).context("result.json")?);
    } else {
        print_table(&plan.config, &result, &plan.folder)?;
    }
    Ok(())
}

/// The configuration and processes of a training that was interrupted.
fn resolved_before(folder: &Path) -> Result<(RunConfig, Launch), Failure> {
    let read = |name: &str| {
        let path = folder.join(name);
        fs::read_to_string(&path).map_err(|error| {
            Failure::User(format!(
                "--resume {}: no training to go on with: {error}",
                path.display()
            ))
        })
    };
    let config = RunConfig::from_resolved(&read("config.toml")?)?;
    let launch = Launch::parse("launch.toml", &read("launch.toml")?)?;
    Ok((config, launch))
}

/// Runs the pipeline; whatever happens, nothing of it stays in shared memory.
pub(crate) fn run(plan: &Plan) -> Result<RunFacts, Failure> {
    let names = RunNames::create().map_err(|error| Failure::User(error.to_string()))?;
    let names = Removed(names);
    // Held until the end: as long as it is, nobody sweeps this run away.
    let lock = File::create(names.0.root.join(LOCK_FILE))?;
    lock.lock()?;

    let folder = &plan.folder;
    let text = toml::to_string(&plan.config).context("the configuration")?;
    write(&folder.join("config.toml"), &text)?;
    let text = toml::to_string(&plan.launch).context("the launch file")?;
    write(&folder.join("launch.toml"), &text)?;
    log_to(&log_of_orchestrator(folder))?;

    let span = tracing::info_span!("run", run = format!("{:016x}", names.0.run));
    span.in_scope(|| {
        let mut progress = Progress::new(plan.quiet, plan.config.drive.tick_s);
        let result = Pipeline::new(plan, &names.0, &mut progress)
            .and_then(|mut pipeline| pipeline.run_to_end());
        progress.finish();
        result
    })
}

/// Everything of a run, removed with this.
struct Removed(RunNames);

impl Drop for Removed {
    fn drop(&mut self) {
        self.0.remove();
    }
}

fn write(path: &Path, text: &str) -> Result<(), Failure> {
    fs::write(path, text).with_context(|| format!("failed to write {path:?}"))?;
    Ok(())
}

/// The orchestrator's own log goes to a file: the terminal belongs to the user.
fn log_to(path: &Path) -> Result<(), Failure> {
    let file = OpenOptions::new()
        .create(true)
        .append(true)
        .open(path)
        .with_context(|| format!("failed to write {path:?}"))?;
    runtime::logging::init_to(Mutex::new(file));
    Ok(())
}

fn resolve_launch(args: &TrainArgs) -> Result<Launch, Failure> {
    let mut launch = match &args.launch {
        None => Launch::train(),
        Some(file) => Launch::parse(&file.display().to_string(), &read(file, "--launch")?)?,
    };
    for replacement in &args.replace {
        launch.replace(replacement)?;
    }
    Ok(launch)
}

fn resolve_config(args: &TrainArgs, launch: &Launch) -> Result<RunConfig, Failure> {
    let mut layers = Layers::maneuver(args.maneuver.as_deref().unwrap_or_default())?;
    if let Some(file) = &args.config {
        layers.add_document(&file.display().to_string(), &read(file, "--config")?)?;
    }
    for assignment in &args.set {
        layers.set(assignment)?;
    }
    if let Some(alphas) = &args.alphas {
        layers.put("--alphas", "run.alphas", alphas.clone())?;
    }
    if let Some(seed) = args.seed {
        layers.put("--seed", "run.seed", seed as i64)?;
    }
    if let Some(fleet) = args.fleet {
        layers.put("--fleet", "run.fleet", i64::from(fleet))?;
    }
    if let Some(episodes) = args.episodes {
        layers.put("--episodes", "learning.episodes", i64::from(episodes))?;
    }
    if args.noise {
        layers.put("--noise", "noise.enabled", true)?;
    }
    // Drives of a vehicle that does not repeat itself must not be taken for each other.
    let repeats = launch.process.iter().all(|entry| entry.is_deterministic());
    if args.no_memo || !repeats {
        layers.put("--no-memo", "run.memo", false)?;
    }
    if let Some(tuner) = args.tuner {
        let name = match tuner {
            TunerArg::EducatedQ => "educated-q",
            TunerArg::Q => "q",
        };
        layers.put("--tuner", "learning.tuner", name)?;
    }
    Ok(layers.resolve()?)
}

fn read(file: &Path, option: &str) -> Result<String, Failure> {
    fs::read_to_string(file)
        .map_err(|error| Failure::User(format!("{option} {}: {error}", file.display())))
}

/// The output folder that was named, or one named after manoeuvre and time.
fn folder_of(args: &TrainArgs, config: &RunConfig) -> PathBuf {
    if let Some(folder) = &args.out {
        return folder.clone();
    }
    let time = jiff::Zoned::now().strftime("%Y%m%d-%H%M%S").to_string();
    let name = format!("runs/{}-{time}", config.maneuver);
    // Two runs may start in the same second.
    let numbered = (2..).map(|number| format!("{name}-{number}"));
    std::iter::once(name.clone())
        .chain(numbered)
        .map(PathBuf::from)
        .find(|folder| !folder.exists())
        .expect("some number is free")
}
